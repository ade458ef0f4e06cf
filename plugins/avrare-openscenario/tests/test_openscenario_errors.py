"""OpenSCENARIO files that are refused, at their place, and what a scenario of one depends on."""

import re
import shutil
from pathlib import Path

import pytest

from avrare.base.errors import AvrareError, ScenarioError, UsageError
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from avrare.stack.builder import build_stack
from avrare_openscenario.distributions import read_distributions
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.xml_tree import read_xml
from openscenario_files import (
    EUCLIDEAN,
    GAP,
    LANE,
    SCENARIOS,
    STEP,
    change_lane,
    document,
    drive,
    event,
    lane_position,
    of_entity,
    slow_down,
)


def test_what_the_ego_is_told_to_do_is_refused_or_passed_over(build):
    text = document(event(slow_down()), actor="Ego")
    with pytest.raises(UsageError, match="driven by the controller") as caught:
        build(text)
    assert "ignore_ego_events" in caught.value.hint
    assert (drive(build(text, ignore_ego_events=True), 3.0)["speed"] == 20.0).all()


def test_what_the_ego_is_to_begin_with_is_refused_or_passed_over(build):
    slow_start = STEP.replace('"step"', '"linear"').replace('value="0"', 'value="2"')
    text = document().replace(STEP, slow_start, 1)
    with pytest.raises(UsageError, match="driven by the controller"):
        build(text)
    assert (drive(build(text, ignore_ego_events=True), 3.0)["speed"] == 20.0).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<LaneChangeTarget>", '<LaneChangeTarget old="1">', "LaneChangeTarget: the attribute old is not"),
        ("cubic", "quartic", r"dynamicsShape should be one of step, .*'quartic'"),
        (LANE, LANE.replace("2", "9"), "there is no lane -9"),
        ('value="2.0"/><LaneChange', 'value="$w"/><LaneChange', "no parameter 'w' is declared"),
        ('value="2.0"/><LaneChange', 'value="${import(1)}"/><LaneChange', "neither a number nor an"),
        ("LaneChangeAction>", "FollowTrajectoryAction>", "FollowTrajectoryAction: lacks the element Traj"),
        ("LaneChangeAction>", "AssignRouteAction>", "AssignRouteAction: lacks the element Route"),
        ("<StartTrigger>", "<StartTrigger><ConditionGroup/>", "ConditionGroup: has no condition"),
        ('entityRef="Car"', 'entityRef="Cat"', "there is no entity 'Cat'"),
        ('revMajor="1"', 'revMajor="2"', r"only OpenSCENARIO XML 1\.x"),
        ('laneId="-3"', 'laneId="0"', "nobody drives on lane 0|there is no lane 0"),
        ('length="4.5"', 'length="nan"', "Dimensions: length: nan is no finite number"),
        ("<SimulationTimeCondition", "<TimeOfDayCondition", "TimeOfDayCondition: is not read"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_named_at_its_place(build, old, new, message):
    text = document(event(change_lane()))
    assert old in text
    line = text[: text.index(old)].count("\n") + 1
    with pytest.raises(UsageError) as caught:
        build(text.replace(old, new))
    found = re.search(r"scene\.xosc:(\d+):(\d+): ", caught.value.message)
    assert re.search(message, caught.value.message), caught.value.message
    assert int(found[1]) >= line


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('length="80.0"', 'length="-80.0"', r":10:13: geometry: the length should be above 0"),
        ('x="100.0"', 'x="101.0"', r":10:13: geometry: begins 1 m and 0 rad from the end"),
        ('id="-2"', 'id="-4"', r"laneSection: the ids of its lanes do not count"),
        ('id="-2"', 'id="-1"', r"laneSection: the ids of its lanes do not count"),
        ('curvEnd="0.00125"', 'curvEnd="1e3"', r"spiral: turns by more than 100 rad"),
        ('<arc curvature="0.00125"/>', '<circle r="800"/>', r"circle: is not read"),
        ('rule="RHT"', 'side="LHT"', r"road: the attribute side is not read"),
    ],
)
def test_roads_that_are_not_read(tmp_path, old, new, message):
    text = (SCENARIOS / "openscenario" / "motorway.xodr").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "road.xodr"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        read_opendrive(str(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no XML"),
        (b"<OpenSCENARIO>", r":1:15: no XML"),
        (b"<a/>", "should begin with OpenSCENARIO"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><OpenSCENARIO>&b;</OpenSCENARIO>', "a document type is declared"),
        (b"<OpenSCENARIO>" + b"<a>" * 70, "more than 64 elements"),
        (b"\xff\xfe\x00\x00", "no XML"),
        (b'<?xml version="1.0" encoding="nonsense"?><OpenSCENARIO/>', "no XML"),
    ],
)
def test_files_of_strangers(tmp_path, content, message):
    path = tmp_path / "a.xosc"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=message):
        read_xml(str(path), "OpenSCENARIO")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document(event(slow_down(dimension="time", value=-4.0))), r"Dynamics: value should be at least 0"),
        (document(event(slow_down(value="${1e-400 * 4 / 0}"))), "no finite number"),
        (document(event(slow_down(value="${1 * " + "9" * 320 + "}"))), "neither a number nor"),
        (document(event(slow_down(), of_entity(EUCLIDEAN))), "time to collision is read along the road"),
        (
            document(event(slow_down(), of_entity(GAP.replace("true", "yes")))),
            "freespace should be one of true",
        ),
        (document(car=lane_position(5000.0)), r"'Car' begins at 5000 m of its road"),
        (document(car=lane_position(-1.0)), r"'Car' begins at -1 m of its road"),
        (document().replace('y="0" z="0"/>', 'y="0.2" z="0"/>'), "middle of the vehicle: y = 0"),
    ],
)
def test_numbers_that_cannot_be(build, text, message):
    with pytest.raises(UsageError, match=message):
        build(text)


@pytest.mark.parametrize("name", ["length", "width"])
def test_what_the_file_says_of_the_ego_is_no_option(build, name):
    with pytest.raises(UsageError, match=rf"ego\.{name}: that of the ego is given by") as caught:
        build(document(), ego={name: 2.0})
    assert "parameters" in caught.value.hint


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("dt=abc", r"dt: should be a number"),
        ("dt=0", r"dt: should be greater than 0"),
        ("parameters=[1]", r"parameters: should be"),
        ("parameters.EgoSpeed=.nan", r"EgoSpeed"),
        ("ego.speed=3", r"ego\.speed is that of the file"),
    ],
)
def test_options_that_cannot_be(option, message):
    with pytest.raises(AvrareError, match=message):
        build_stack(load(SCENARIOS / "cut_in.yaml", [f"simulator.{option}"]))


@pytest.mark.parametrize("name", ["scene.xosc", "7", "", "a b"])
def test_names_that_no_parameter_has(tmp_path, name):
    text = (SCENARIOS / "openscenario" / "cut_in_distributions.xosc").read_text(encoding="utf-8")
    path = tmp_path / "named.xosc"
    path.write_text(text.replace('"CutInSpeed"', f'"{name}"'), encoding="utf-8")
    with pytest.raises(UsageError, match=r"named\.xosc:12:\d+: .*is no name of a parameter"):
        read_distributions(read_xml(str(path), "OpenSCENARIO"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SCENARIOS / "_base", tmp_path / "own" / "_base")
    shutil.copytree(SCENARIOS / "openscenario", tmp_path / "own" / "openscenario")
    shutil.copy(SCENARIOS / "cut_in.yaml", tmp_path / "own")
    return tmp_path / "own"


def replace_in(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("cut_in.xosc", 'name="Braking" parameterType="double" value="2.0"', 'name="Braking" value="2.5"'),
        ("cut_in_distributions.xosc", 'variance="0.64"', 'variance="0.65"'),
        ("motorway.xodr", 'curvature="0.00125"', 'curvature="0.0012501"'),
    ],
)
def test_a_scenario_is_another_when_one_of_its_files_is(folder, name, old, new):
    before = fingerprint(load(folder / "cut_in.yaml"))
    assert fingerprint(load(folder / "cut_in.yaml")) == before
    replace_in(folder / "openscenario" / name, old, new)
    assert fingerprint(load(folder / "cut_in.yaml")) != before


@pytest.mark.parametrize(
    ("name", "target", "what"),
    [
        ("cut_in.xosc", "motorway.xodr", "RoadNetwork: LogicFile"),
        ("cut_in_distributions.xosc", "cut_in.xosc", "ParameterValueDistribution: ScenarioFile"),
    ],
)
def test_files_that_a_file_names_stay_in_the_folder_in_safe_mode(folder, name, target, what):
    with safe_mode():
        load(folder / "cut_in.yaml")
    shutil.copytree(folder / "openscenario", folder.parent / "openscenario")
    replace_in(
        folder / "openscenario" / name,
        f'"{target}"',
        f'"{Path("..", "..", "openscenario", target).as_posix()}"',
    )
    load(folder / "cut_in.yaml")
    with safe_mode(), pytest.raises(ScenarioError, match=f"{what} .* leads out of the scenario's folder"):
        load(folder / "cut_in.yaml")
