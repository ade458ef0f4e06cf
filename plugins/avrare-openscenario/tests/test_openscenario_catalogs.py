"""Catalogs of OpenSCENARIO: vehicles and maneuvers by reference drive as those in the file itself."""

import re
import shutil

import numpy as np
import pytest

from avrare.base.errors import ScenarioError, UsageError
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from openscenario_files import CAR, SCENARIOS, document, drive, event, slow_down

CATALOG = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" description="" author=""/>
<Catalog name="{name}">
{entry}
</Catalog></OpenSCENARIO>"""
DECLARED = (
    '<ParameterDeclarations><ParameterDeclaration name="{}" parameterType="double" value="{}"/>'
    "</ParameterDeclarations>"
)
LOCATIONS = """<CatalogLocations><VehicleCatalog><Directory path="catalogs"/></VehicleCatalog>
<ManeuverCatalog><Directory path="catalogs"/></ManeuverCatalog></CatalogLocations>"""
REFERENCE = '<CatalogReference catalogName="{}" entryName="{}">{}</CatalogReference>'
BRAKE = "${6 * $harder}"


def assign(name, value):
    assigned = f'<ParameterAssignment parameterRef="{name}" value="{value}"/>'
    return f"<ParameterAssignments>{assigned}</ParameterAssignments>"


@pytest.fixture
def catalogs(tmp_path):
    """Write a catalog of vehicles of any size, and one of maneuvers, which may brake harder."""
    folder = tmp_path / "catalogs"
    folder.mkdir()
    car = CAR.format(ahead=0.0).replace('length="4.5"', 'length="$size"')
    car = car.replace('Category="car">', 'Category="car">' + DECLARED.format("size", 4.5))
    brake = event(slow_down("linear", "rate", BRAKE, "10.0"))
    maneuver = f'<Maneuver name="brake">{DECLARED.format("harder", 0.5)}{brake}</Maneuver>'
    for name, entry in (("cars", car), ("acts", maneuver)):
        (folder / f"{name}.xosc").write_text(CATALOG.format(name=name, entry=entry), encoding="utf-8")
    return folder


def referring(assigned="", vehicle="", text=None):
    """Return a scenario whose car and whose maneuver stand in catalogs."""
    text = text or document(event(slow_down()))
    text = text.replace("<RoadNetwork>", LOCATIONS + "<RoadNetwork>")
    text = text.replace(CAR.format(ahead=0.0), REFERENCE.format("cars", "car", vehicle), 1)
    reference = REFERENCE.format("acts", "brake", assigned)
    return re.sub(r'<Maneuver name="m">.*</Maneuver>', reference, text, flags=re.DOTALL)


@pytest.mark.parametrize(
    ("assigned", "rate"),
    [
        ("", 3.0),
        (assign("harder", 0.75), 4.5),
        (assign("harder", "$v"), 120.0),
        (assign("harder", "${$v / 40}"), 3.0),
    ],
)
def test_what_stands_in_catalogs_drives_as_if_it_stood_in_the_file(build, catalogs, assigned, rate):
    found = drive(build(referring(assigned)), 3.0)
    alone = drive(build(document(event(slow_down(value=rate)))), 3.0)
    for name, values in alone.items():
        np.testing.assert_array_equal(found[name], values)


def test_parameters_that_are_drawn_reach_into_catalogs(build, catalogs):
    simulator = build(referring(assign("harder", "${$v / 40}")))
    values = np.array([10.0, 20.0, 30.0])
    found = drive(simulator, 1.6, 3, {"parameters.v": values})["acceleration"]
    expected = -np.minimum(6.0 * values / 40.0, 6.0)
    np.testing.assert_allclose(found[13, 1:, 0], expected[1:])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'entryName="brake"',
            'entryName="break"',
            r"xosc:\d+:\d+: CatalogReference: there is no entry 'break'",
        ),
        (
            'catalogName="acts"',
            'catalogName="act"',
            r"xosc:\d+:\d+: CatalogReference: there is no catalog 'act'",
        ),
        (
            'catalogName="acts" entryName="brake"',
            'catalogName="cars" entryName="car"',
            "the entry 'car' is a Vehicle",
        ),
        (
            'parameterRef="harder"',
            'parameterRef="hard"',
            r"ParameterAssignment: the entry 'brake' has no parameter",
        ),
        ('path="catalogs"', 'path="nowhere"', r"no catalog 'cars'\nhint: .*none; \S*nowhere is not a folder"),
        ('value="0.7"', 'value="$u"', r"acts\.xosc:3:\d+: .*no parameter 'u' is declared"),
    ],
)
def test_references_to_nothing_are_named_at_their_place(build, catalogs, old, new, message):
    text = referring(assign("harder", "0.7"))
    assert old in text
    with pytest.raises(UsageError, match=message):
        build(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("$harder", "$v", r"acts\.xosc:3:\d+: SpeedActionDynamics: no parameter 'v' is declared"),
        ("Dynamics dyn", 'Dynamics old="1" dyn', r"acts\.xosc:3:\d+: .*attribute old is not read"),
        ("</Maneuver>", "<Other x='1'/></Maneuver>", r"acts\.xosc:3:\d+: Other: is not read in Maneuver"),
        (
            'value="0.5"',
            'value="$v"',
            r"acts\.xosc:3:\d+: Maneuver: no parameter 'v' is declared in this entry",
        ),
        ("/></ParameterD", "><Group a='1'/></ParameterDeclaration></ParameterD", "Group: is not read"),
        ('<Catalog name="acts">', '<Catalog name="cars">', r"there are two catalogs 'cars'"),
        (
            "</Catalog>",
            '<Maneuver name="brake"/></Catalog>',
            r"acts\.xosc:4:1: Maneuver: a second entry 'brake'",
        ),
    ],
)
def test_what_is_not_understood_in_a_catalog_is_named_there(build, catalogs, old, new, message):
    path = catalogs / "acts.xosc"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(UsageError, match=message):
        build(referring())


@pytest.fixture
def scenario(catalogs, monkeypatch):
    folder = catalogs.parent
    monkeypatch.chdir(folder)
    shutil.copytree(SCENARIOS / "_base", folder / "_base")
    shutil.copy(SCENARIOS / "openscenario" / "motorway.xodr", folder)
    (folder / "scene.xosc").write_text(referring(), encoding="utf-8")
    text = (SCENARIOS / "cut_in.yaml").read_text(encoding="utf-8")
    text = text.replace("openscenario/cut_in_distributions.xosc", "scene.xosc")
    (folder / "s.yaml").write_text(text, encoding="utf-8")
    return folder / "s.yaml"


def test_a_result_depends_on_the_catalogs_that_are_used(scenario, catalogs):
    before = fingerprint(load(scenario))
    (catalogs / "more.xosc").write_text(CATALOG.format(name="more", entry=""))
    assert fingerprint(load(scenario)) == before
    path = catalogs / "acts.xosc"
    path.write_text(path.read_text().replace('value="0.5"', 'value="0.6"'))
    assert fingerprint(load(scenario)) != before


def test_catalogs_of_strangers_lie_in_their_folder(scenario, catalogs):
    with safe_mode():
        load(scenario)
    outside = catalogs.parent.parent / f"{catalogs.parent.name}-outside"
    shutil.move(str(catalogs), outside)
    scene = scenario.parent / "scene.xosc"
    scene.write_text(scene.read_text().replace('path="catalogs"', f'path="../{outside.name}"'))
    load(scenario)
    with safe_mode(), pytest.raises(ScenarioError, match="leads out of the scenario's folder"):
        load(scenario)


def test_a_catalog_is_also_found_by_the_name_of_its_file(build, catalogs):
    (catalogs / "acts.xosc").rename(catalogs / "maneuvers.xosc")
    text = referring().replace('catalogName="acts"', 'catalogName="maneuvers"')
    assert build(text).scene.lengths[0] == 4.5


def test_a_location_that_is_not_needed_may_be_missing(build, catalogs):
    more = '<RouteCatalog><Directory path="nowhere"/></RouteCatalog></CatalogLocations>'
    text = referring().replace('path="catalogs"', 'path=".\\catalogs\\"', 1)
    assert build(text.replace("</CatalogLocations>", more)).scene.lengths[0] == 4.5
