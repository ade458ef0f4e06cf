"""OpenSCENARIO files: what vehicles do is what the file says; what is not read is named at its place."""

from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import ScenarioError, UsageError
from avrare.scenario.load import load
from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.distributions import read_distributions
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.simulator import OpenScenario
from avrare_openscenario.xml_tree import read_xml
from openscenario_files import (
    APART,
    AT_ONE,
    COLLISION,
    FASTER,
    GAP,
    HEADWAY,
    REACH,
    SCENARIOS,
    change_lane,
    document,
    drive,
    event,
    lane_position,
    of_entity,
    slow_down,
    state_of,
)


@pytest.mark.parametrize(
    ("shape", "dimension", "value", "seconds", "halfway"),
    [
        ("linear", "rate", 4.0, 2.5, 0.5),
        ("linear", "time", 2.0, 2.0, 0.5),
        ("cubic", "time", 4.0, 4.0, 0.5),
        ("cubic", "rate", 5.0, 3.0, 0.5),
        ("sinusoidal", "rate", 5.0 * np.pi / 3.0, 3.0, 0.5),
        ("linear", "distance", 30.0, 2.0, 0.5),
    ],
)
def test_speeds_follow_their_shapes(build, shape, dimension, value, seconds, halfway):
    found = drive(build(document(event(slow_down(shape, dimension, value)))), 6.0)
    speed = found["speed"][:, 0, 0]
    assert (speed[:11] == 20.0).all()
    assert (speed[11:] < 20.0).all()
    middle = 10 + seconds * 5.0
    assert np.interp(middle, np.arange(len(speed)), speed) == pytest.approx(20.0 - 10.0 * halfway, abs=0.02)
    quarter = np.interp(10 + seconds * 2.5, np.arange(len(speed)), speed)
    share = {"linear": 0.25, "cubic": 0.15625, "sinusoidal": 0.5 - 0.5 * np.cos(np.pi / 4)}[shape]
    assert quarter == pytest.approx(20.0 - 10.0 * share, abs=0.05)
    end = round(10 + seconds * 10)
    assert (speed[end:] == 10.0).all()
    assert speed[end - 1] > 10.0
    # positions are the integral; the first 100 m of the road are straight, beyond the line bends inwards
    way = found["x"][end, 0, 0] - found["x"][10, 0, 0]
    if found["x"][end, 0, 0] < 100.0:
        assert way == pytest.approx(15.0 * seconds, abs=0.02)


def test_a_step_changes_the_speed_at_once(build):
    found = drive(build(document(event(slow_down("step", "time", 0.0)))), 2.0)
    assert found["speed"][:, 0, 0].tolist() == [20.0] * 11 + [10.0] * 10
    np.testing.assert_allclose(found["x"][11, 0, 0] - found["x"][10, 0, 0], 1.0)


@pytest.mark.parametrize(
    ("action", "end", "target"),
    [
        (change_lane(), 30, -5.25),
        (change_lane("linear", "rate", 1.75), 30, -5.25),
        (change_lane(target='<RelativeTargetLane entityRef="Car" value="1"/>'), 30, -5.25),
        (
            change_lane(
                target='<RelativeTargetLane entityRef="Ego" value="1"/>', offset=' targetLaneOffset="0.5"'
            ),
            30,
            -1.25,
        ),
    ],
)
def test_lane_changes(build, action, end, target):
    found = drive(build(document(event(action))), 4.0)
    y, heading = found["y"][:, 0, 0], found["heading"][:, 0, 0]
    assert (y[:11] == -8.75).all()
    assert y[20] == pytest.approx(0.5 * (target - 8.75), abs=1e-9)
    assert y[end:] == pytest.approx(target, abs=1e-12)
    assert (heading[12:end] > 0.0).all()
    assert (heading[end + 1 :] == 0.0).all()
    slopes = np.diff(y) / 2.0  # 2 m a step
    aside = np.sin(heading[12:end]) - 0.5 * (slopes[12:end] + slopes[11 : end - 1])
    assert np.abs(aside).max() < 0.002


def test_the_distance_of_a_lane_change_is_one_along_the_road(build):
    found = drive(build(document(event(change_lane("sinusoidal", "distance", 40.0)))), 4.0)
    x, y = found["x"][:, 0, 0], found["y"][:, 0, 0]
    share = np.clip((x - x[10]) / 40.0, 0.0, 1.0)
    np.testing.assert_allclose(y, -8.75 + 3.5 * (0.5 - 0.5 * np.cos(np.pi * share)), atol=0.01)


@pytest.mark.parametrize(
    ("condition", "options", "step"),
    [
        (AT_ONE, {}, 10),
        (AT_ONE, {"delay": "0.5"}, 15),
        (AT_ONE, {"edge": "rising"}, 10),
        (AT_ONE.replace("greaterOrEqual", "greaterThan"), {}, 11),
        (of_entity('<TraveledDistanceCondition value="20.0"/>'), {}, 10),
        (of_entity('<SpeedCondition value="19.0" rule="greaterThan"/>'), {}, 0),
        (of_entity('<SpeedCondition value="19.0" rule="greaterThan"/>'), {"edge": "rising"}, None),
        (of_entity(HEADWAY), {}, None),
        (of_entity(GAP), {"speed": 25.0}, 9),  # 15.5 m and 5 m/s more
        (of_entity(APART, "Ego"), {"speed": 25.0}, 10),  # 24.75 m and 3.5 m aside
        (of_entity(REACH), {}, 14),
        (of_entity(FASTER), {"speed": 25.0}, 0),
        (of_entity(COLLISION), {"speed": 15.0}, 10),  # 20 m, closing at 5 m/s
    ],
)  # fmt: skip
def test_conditions(build, condition, options, step):
    speed = options.pop("speed", 20.0)
    text = document(event(change_lane("linear", "time", 1.0), condition, **options), speed=speed)
    y = drive(build(text), 3.0)["y"][:, 0, 0]
    moved = np.flatnonzero(y != -8.75)
    assert (moved[0] - 1 if len(moved) else None) == step


def test_an_event_after_another_and_one_that_overrides(build):
    state = (
        '<ByValueCondition><StoryboardElementStateCondition storyboardElementType="event" '
        'storyboardElementRef="first" state="completeState"/></ByValueCondition>'
    )
    text = document(event(change_lane()), event(slow_down("linear", "time", 1.0), state, "second"))
    speed = drive(build(text), 5.0)["speed"][:, 0, 0]
    assert np.flatnonzero(speed < 20.0)[0] == 31  # the lane change lasts from 1 s to 3 s
    late = AT_ONE.replace("1.0", "2.0")
    text = document(
        event(slow_down("linear", "time", 4.0)), event(change_lane(), late, "second", priority="override")
    )
    found = drive(build(text), 5.0)
    assert found["speed"][-1, 0, 0] == found["speed"][20, 0, 0] == 17.5
    assert found["y"][-1, 0, 0] == pytest.approx(-5.25, abs=1e-12)


def test_the_point_of_reference_is_the_rear_axle(build):
    world = build(document(ahead=1.4)).reset(np.zeros((1, 0)))
    assert world.others.x[0, 0] == 31.4
    assert world.ego.x[0] == 11.4


@pytest.mark.parametrize(
    ("position", "x", "y"),
    [
        (lane_position(40, -1, 0.25), 40.0, -1.5),
        ('<RoadPosition roadId="1" s="40" t="-2.0"/>', 40.0, -2.0),
        ('<WorldPosition x="40" y="-1.75" z="0" h="0" p="0" r="0"/>', 40.0, -1.75),
        ('<RelativeLanePosition entityRef="Ego" dLane="-1" ds="12"/>', 22.0, -8.75),
        ('<RelativeRoadPosition entityRef="Ego" ds="12" dt="1"/>', 22.0, -4.25),
        ('<RelativeObjectPosition entityRef="Ego" dx="12" dy="-3"/>', 22.0, -8.25),
        ('<RelativeLanePosition entityRef="Ego" dLane="1" ds="${2 * $v - max(4, 6)}"/>', 44.0, -1.75),
    ],
)
def test_positions(build, position, x, y):
    world = build(document(car=position)).reset(np.zeros((2, 0)))
    np.testing.assert_allclose(world.others.x[:, 0], x, rtol=1e-12)
    np.testing.assert_allclose(world.others.y[:, 0], y, rtol=1e-12)


def test_world_positions_in_the_bend_and_an_end_on_its_lane(build):
    (roads,) = read_opendrive(str(SCENARIOS / "openscenario" / "motorway.xodr")).maps
    x, y = (part.item() for part in roads.line.to_plane(np.array([300.0]), np.array([-8.75])))
    heading = roads.line.heading(np.array([300.0])).item()
    place = f'<WorldPosition x="{x}" y="{y}" h="{heading}"/>'
    found = drive(build(document(car=place)), 2.0)
    np.testing.assert_allclose(found["y"], -8.75, atol=1e-9)
    np.testing.assert_allclose(found["heading"], 0.0, atol=1e-9)
    # 40 m at 8.75 m outside of a bend of 800 m
    assert found["x"][-1, 0, 0] == pytest.approx(300.0 + 40.0 / (1.0 + 8.75 / 800.0), abs=1e-6)


def test_drawn_parameters_are_those_of_each_rollout(build):
    text = document(event(slow_down("linear", "time", "${$v / 10}", "${$v - 5}")))
    simulator = build(text)
    speeds = np.array([15.0, 20.0, 25.0])
    found = drive(simulator, 5.0, 3, {"parameters.v": speeds})
    np.testing.assert_array_equal(found["speed"][0, :, 0], speeds)
    np.testing.assert_array_equal(found["speed"][-1, :, 0], speeds - 5.0)
    for row, speed in enumerate(speeds):  # a row does not depend on the others, nor on how it got its value
        alone = drive(simulator, 5.0, 1, {"parameters.v": np.array([speed])})
        given = drive(build(text, parameters={"v": float(speed)}), 5.0)
        for name, field in found.items():
            np.testing.assert_array_equal(field[:, row : row + 1], alone[name])
            np.testing.assert_array_equal(field[:, row : row + 1], given[name])


def test_a_scenario_with_distributions():
    scenario = load(SCENARIOS / "cut_in.yaml")
    draws = scenario.simulator.draws
    names = ("CutInGap", "CutInSpeed", "EgoSpeed", "LaneChangeTime")
    assert draws.names == tuple(f"parameters.{name}" for name in names)
    assert draws.laws[2].model_dump()["of"] == {"law": "normal", "mean": 25.0, "sd": 1.0}
    assert scenario.simulator.config.road.name == "motorway.xodr"
    fixed = load(SCENARIOS / "cut_in.yaml", ["simulator.parameters.EgoSpeed=24.0"])
    assert len(fixed.simulator.draws.names) == 3
    with pytest.raises(ScenarioError, match="no parameter 'EgoSped' is declared"):
        load(SCENARIOS / "cut_in.yaml", ["simulator.parameters.EgoSped=24.0"])
    with pytest.raises(ScenarioError, match=r"entity 'Egon'"):
        load(SCENARIOS / "cut_in.yaml", ["simulator.entity=Egon"])


@pytest.mark.parametrize(
    ("kind", "name", "state", "step"),
    [
        ("story", "s", "runningState", 0),
        ("act", "a", "startTransition", 1),  # at its own begin, not at that of its first event
        ("act", "s::a", "runningState", 1),
        ("maneuver", "m", "runningState", 1),
        ("event", "m::first", "startTransition", 11),
        ("event", "first", "completeState", 20),
        ("action", "act of first", "endTransition", 20),
    ],
)
def test_states_of_elements(build, kind, name, state, step):
    text = document(
        event(change_lane("linear", "time", 1.0)),
        event(slow_down("step", "time", 0.0), state_of(kind, name, state), "second"),
    )
    speed = drive(build(text), 3.0)["speed"][:, 0, 0]
    assert np.flatnonzero(speed < 20.0)[0] - 1 == step


def test_a_step_over_a_distance_takes_no_time(build):
    text = document(
        event(slow_down("step", "distance", 60.0)),
        event(change_lane(), state_of("event", "first", "completeState"), "second"),
    )
    found = drive(build(text), 2.0)
    np.testing.assert_allclose(found["x"][11, 0, 0] - found["x"][10, 0, 0], 1.0)
    assert np.flatnonzero(found["y"][:, 0, 0] != -8.75)[0] == 12


def test_a_drawn_number_that_cannot_be_breaks_down_its_rollout_alone(build):
    simulator = build(document(event(slow_down("linear", "time", "${sqrt($v - 18)}"))))
    world = simulator.reset_drawn(np.zeros((3, 0)), {"parameters.v": np.array([20.0, 17.0, -1.0])})
    assert simulator.faults(world).tolist() == [False, True, True]


def test_a_headway_is_a_distance_in_the_plane_unless_it_is_along_the_road(build):
    # 20 m ahead in the next lane but one: 1 s along the road, sqrt(20^2 + 7^2) m in the plane
    for extra, begins in (("", False), ('alongRoute="true" ', True)):
        near = HEADWAY.replace("value", extra + "value").replace("1.5", "1.03")
        text = document(event(slow_down(), of_entity(near.replace("greaterThan", "lessThan"))))
        text = text.replace('laneId="-2"', 'laneId="-1"')
        assert (drive(build(text), 1.0)["speed"][-1, 0, 0] < 20.0) is np.bool_(begins)


def test_a_set_of_values_with_probabilities_is_a_discrete_law(tmp_path):
    text = (SCENARIOS / "openscenario" / "cut_in_distributions.xosc").read_text(encoding="utf-8")
    begin = text.index("<StochasticDistribution ")
    name = text[begin:].split('parameterName="')[1].split('"')[0]
    end = text.index("</StochasticDistribution>", begin)
    parts = "".join(
        f'<Element value="{v}" weight="{w}"/>' for v, w in ((24.0, 2.0), (20.0, 1.0), (9.0, 0.0), (24.0, 1.0))
    )
    one = f'<StochasticDistribution parameterName="{name}">'
    one += f"<ProbabilityDistributionSet>{parts}</ProbabilityDistributionSet>"
    path = tmp_path / "set.xosc"
    path.write_text(text[:begin] + one + text[end:], encoding="utf-8")
    _, laws = read_distributions(read_xml(str(path), "OpenSCENARIO"))
    assert laws[name] == {"law": "discrete", "values": [20.0, 24.0], "weights": [1.0, 3.0]}
    path.write_text(
        path.read_text(encoding="utf-8").replace('<Element value="24.0"', '<Element value="20.0"'),
        encoding="utf-8",
    )
    with pytest.raises(UsageError, match="fewer than two values"):
        read_distributions(read_xml(str(path), "OpenSCENARIO"))


def test_offsets_that_are_left_out_are_0(build):
    text = document(event(change_lane(offset=' targetLaneOffset="0"')), car=lane_position(30))
    bare = text.replace(' offset="0"', "").replace(' targetLaneOffset="0"', "")
    assert bare != text
    for name, values in drive(build(text), 4.0).items():
        np.testing.assert_array_equal(drive(build(bare), 4.0)[name], values)


def test_t_counts_from_the_reference_line_whatever_the_lanes_offset(build):
    simulator = build(document(event(slow_down()), car='<RoadPosition roadId="1" s="40" t="0"/>'))
    road = Path(simulator.file.road_path)
    shifted = road.read_text(encoding="utf-8").replace(
        "<lanes>", '<lanes><laneOffset s="0" a="1.2" b="0" c="0" d="0"/>'
    )
    assert "laneOffset" in shifted
    road.write_text(shifted, encoding="utf-8")
    again = OpenScenario(OpenScenarioConfig(file=simulator.file.path))
    assert again.reset(np.zeros((1, 0))).others.y[0, 0] == pytest.approx(0.0)
    lanes, before = again.file.maps[-1].road.lane_centres, simulator.file.maps[-1].road.lane_centres
    np.testing.assert_allclose(np.array(lanes) - before, 1.2)


def test_each_of_several_conditions_is_asked_what_held_its_delay_ago(build):
    # The car brakes and drives on: the event begins when it is fast again, a second after it was slow.
    slow = of_entity('<SpeedCondition value="15.0" rule="lessThan"/>', "Car")
    both = (
        "<Condition name='a' delay='1.0' conditionEdge='none'>" + slow + "</Condition>"
        "<Condition name='b' delay='0' conditionEdge='none'>" + AT_ONE + "</Condition>"
    )
    dip = event(slow_down("linear", "time", 2.0, 12.0), AT_ONE, "dip")
    late = AT_ONE.replace("1.0", "3.0")
    back = event(slow_down("linear", "time", 0.5, 20.0), late, "back", priority="override")
    text = document(dip, back, event(change_lane("linear", "time", 1.0), name="last"))
    begin = text.rindex("<Condition name='c'")
    end = text.index("</ConditionGroup>", begin)
    found = drive(build(text[:begin] + both + text[end:]), 6.0)
    first_slow = np.flatnonzero(found["speed"][:, 0, 0] < 15.0)[0]
    moved = np.flatnonzero(found["y"][:, 0, 0] != -8.75)[0] - 1
    assert moved - first_slow in (10, 11)
    assert found["speed"][moved, 0, 0] > 15.0
