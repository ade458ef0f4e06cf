"""Scenes as they are found: how people and their tools vary what they write."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.scenes_command import judge_scene, list_scenes, read_acted
from avrare_openscenario.trace import act_out
from openscenario_files import GAP, SCENARIOS, change_lane, document, event, of_entity, slow_down, state_of

PLAIN = document(event(change_lane()))
CONSTRAINED = '<ParameterDeclaration name="w" value="1"><ConstraintGroup/></ParameterDeclaration>'
ROUTE = (
    '<TeleportAction><Position><RoutePosition><RouteRef><Route name="r" closed="false"><Waypoint><Position>'
    '<LanePosition roadId="1" laneId="-2" s="100"/></Position></Waypoint></Route></RouteRef><InRoutePosition>'
    '<{} pathS="5" laneId="-2"/></InRoutePosition></RoutePosition></Position></TeleportAction>'
)


@pytest.fixture
def judge(tmp_path):
    def judge(content):
        motorway = (SCENARIOS / "openscenario" / "motorway.xodr").read_bytes()
        (tmp_path / "motorway.xodr").write_bytes(motorway)
        path = tmp_path / "scene.xosc"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return judge_scene(str(path))

    return judge


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *(('revMinor="2"', f'revMinor="{minor}"') for minor in "013"),
        ('filepath="motorway.xodr"', 'filepath=".\\\\motorway.xodr"'),
        ('Entities="false"', 'Entities="False"'),
        ('priority="parallel"', 'priority="$how"'),
        (
            "<RoadNetwork>",
            '<MonitorDeclarations><MonitorDeclaration name="m"/></MonitorDeclarations><RoadNetwork>',
        ),
        ("<Entities>", "<!-- people --><?tool x?><Entities>"),
        ("<OpenSCENARIO>", '<OpenSCENARIO xmlns="http://a.b" xmlns:xsi="http://c" xsi:schemaLocation="d">'),
        ("><", ">\r\n\t<"),
        ("<Act ", '<Act xml:lang="en" tool:id="3" '),
        ("Storyboard>", "osc:Storyboard>"),
        ('rule="greaterOrEqual"', 'rule="$rule"'),
        ('triggeringEntitiesRule="any"', 'triggeringEntitiesRule="$amount"'),
        ('storyboardElementRef="first"', 'storyboardElementRef="$which"'),
        ('relativeDistanceType="longitudinal"', 'relativeDistanceType="$way"'),
        ("</ParameterDeclarations>", CONSTRAINED + "</ParameterDeclarations>"),
    ],
)
def test_variations_that_mean_the_same(judge, old, new):
    words = {
        "how": "skip",
        "rule": "greaterOrEqual",
        "amount": "any",
        "which": "first",
        "way": "longitudinal",
    }
    declared = "".join(
        f'<ParameterDeclaration name="{name}" value="{word}"/>' for name, word in words.items()
    )
    second = event(slow_down(), state_of("event", "first", "completeState"), "second")
    text = document(event(change_lane()), second, event(slow_down(), of_entity(GAP), "third"))
    text = text.replace("</ParameterDeclarations>", declared + "</ParameterDeclarations>")
    assert old in text
    assert judge(text.replace(old, new)).status == "read"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1", "windows-1252"])
def test_encodings(judge, encoding):
    name = encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{name}"?>' + PLAIN.replace('author=""', 'author="Jürgen"')
    assert judge(text.encode(encoding)).status == "read"


def test_a_road_file_that_is_not_there_is_named_at_its_line(judge):
    finding = judge(PLAIN.replace("motorway", "highway"))
    assert (finding.line, finding.status) == (4, "refused")
    assert finding.reason.startswith("LogicFile: there is no road file ")


def test_catalogs_are_no_scenes(judge, tmp_path):
    judge(PLAIN)
    catalog = "<OpenSCENARIO><Catalog><StoryboardElementStateCondition/></Catalog></OpenSCENARIO>"
    (tmp_path / "catalog.xosc").write_text(catalog, encoding="utf-8")
    assert list_scenes([str(tmp_path)]) == [str(tmp_path / "scene.xosc")]


BOTH = '<EntitySelection name="Both"><Members>{}</Members></EntitySelection></Entities>'
HEADING = 'angleType="heading" angle="{}" angleTolerance="0.02"'


@pytest.mark.parametrize(
    "members", ['<EntityRef entityRef="Car"/><EntityRef entityRef="Ego"/>', '<ByType objectType="vehicle"/>']
)
def test_a_selection_stands_for_its_members(judge, tmp_path, members):
    text = document(event(slow_down(shape="step", target=5.0)), actor="Both")
    assert judge(text.replace("</Entities>", BOTH.format(members))).status == "read"
    states = act_out(read_acted(str(tmp_path / "scene.xosc"), 0.1), 0.1, 2.0)[1]
    np.testing.assert_array_equal(states[-1, :, 3], [5.0, 5.0])


@pytest.mark.parametrize(
    ("condition", "begins"),
    [
        (f'<AngleCondition {HEADING.format(0.0)} coordinateSystem="road"/>', True),
        (f'<AngleCondition {HEADING.format(6.2832)} coordinateSystem="lane"/>', True),
        (f"<AngleCondition {HEADING.format(0.1)}/>", False),
        (f'<RelativeAngleCondition entityRef="Ego" {HEADING.format(0.0)}/>', True),
        (f'<RelativeAngleCondition entityRef="Ego" {HEADING.format(-0.5)}/>', False),
        ('<CollisionCondition><ByObjectType type="vehicle"/></CollisionCondition>', False),
    ],
)
def test_conditions_on_angles_and_types(judge, tmp_path, condition, begins):
    text = document(event(slow_down(shape="step", target=5.0), of_entity(condition)))
    assert judge(text).status == "read"
    states = act_out(read_acted(str(tmp_path / "scene.xosc"), 0.1), 0.1, 0.5)[1]
    assert states[-1, 0, 3] == (5.0 if begins else 20.0)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        (
            '<SimulationTimeCondition value="1.0" rule="greaterOrEqual"/>',
            '<UserDefinedValueCondition name="a" value="1" rule="equalTo"/>',
            "is never met: nothing outside the file sets values",
        ),
        (
            "</Actions></Init>",
            "<GlobalAction><SetMonitorAction monitorRef='m' value='true'/></GlobalAction></Actions></Init>",
            "monitors change nothing",
        ),
    ],
)
def test_what_is_read_with_a_note(judge, old, new, note):
    finding = judge(PLAIN.replace(old, new))
    assert (finding.status, finding.reason.split(": ")[-1]) == ("notes", note.split(": ")[-1])


def test_a_place_beside_a_road_and_a_closed_route_can_be_reached(judge):
    closed = (
        "<AssignRouteAction><Route name='r' closed='true'><Waypoint>{}</Waypoint></Route></AssignRouteAction>"
    )
    place = "<Position><WorldPosition x='50' y='1'/></Position>"
    acquire = f"<AcquirePositionAction>{place}</AcquirePositionAction>"
    for action in (closed.format(place), acquire):
        assert judge(document(event(f"<RoutingAction>{action}</RoutingAction>"))).status != "refused"


@pytest.mark.parametrize("name", ["FromLaneCoordinates", "PositionInLaneCoordinates"])
def test_places_on_routes_have_two_names(judge, tmp_path, name):
    assert judge(document(event(ROUTE.format(name)))).status == "read"
    states = act_out(read_acted(str(tmp_path / "scene.xosc"), 0.1), 0.1, 2.0)[1]
    np.testing.assert_allclose(states[10:13, 0, 0], [50.0, 105.0, 107.0], atol=0.01)


@pytest.mark.parametrize("seconds", ["1e308", "1e9", "-1"])
def test_a_duration_that_nothing_lasts_is_refused(judge, seconds):
    finding = judge(document(event(slow_down(), of_entity(f'<OffroadCondition duration="{seconds}"/>'))))
    assert finding.reason.startswith("OffroadCondition: duration should be a time from 0 to ")


def test_lanes_of_newer_road_files(tmp_path):
    text = (SCENARIOS / "openscenario" / "motorway.xodr").read_text(encoding="utf-8")
    lane = 'type="driving" roadWorks="false" dynamicLaneType="false"'
    path = tmp_path / "road.xodr"
    path.write_text(text.replace('type="driving"', lane), encoding="utf-8")
    assert read_opendrive(str(path)).maps
    path.write_text(text.replace('a="3.5" b="0.0"', 'a="1e308" b="1e308"'))
    with pytest.raises(UsageError, match="lanes: its lanes have no finite widths"):
        read_opendrive(str(path))
