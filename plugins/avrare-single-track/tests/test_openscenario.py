"""OpenSCENARIO files: what vehicles do is what the file says; what is not read is named at its place."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import AvrareError, ScenarioError, UsageError
from avrare.driving import Action
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from avrare.stack.builder import build_stack
from avrare_single_track.config import OpenScenarioConfig
from avrare_single_track.openscenario.distributions import read_distributions
from avrare_single_track.openscenario.opendrive import read_opendrive
from avrare_single_track.openscenario.simulator import OpenScenario
from avrare_single_track.openscenario.xml_tree import read_xml

SCENARIOS = Path(__file__).parents[3] / "scenarios"
CAR = """<Vehicle name="car" vehicleCategory="car"><BoundingBox><Center x="{ahead}" y="0" z="0"/>
<Dimensions width="1.8" length="4.5" height="1.5"/></BoundingBox></Vehicle>"""
LATERAL = (
    '<LateralAction><LaneChangeAction{offset}><LaneChangeActionDynamics dynamicsShape="{shape}" '
    'dynamicsDimension="{dimension}" value="{value}"/><LaneChangeTarget>{target}</LaneChangeTarget>'
    "</LaneChangeAction></LateralAction>"
)
SPEED = (
    '<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}" '
    'dynamicsDimension="{dimension}" value="{value}"/><SpeedActionTarget>{target}</SpeedActionTarget>'
    "</SpeedAction></LongitudinalAction>"
)
AT_ONE = '<ByValueCondition><SimulationTimeCondition value="1.0" rule="greaterOrEqual"/></ByValueCondition>'
STEP = '<SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>'

HEADWAY = '<TimeHeadwayCondition entityRef="Ego" freespace="false" value="1.5" rule="greaterThan"/>'
GAP = (
    '<RelativeDistanceCondition entityRef="Ego" relativeDistanceType="longitudinal" freespace="true" '
    'value="20.0" rule="greaterOrEqual"/>'
)
APART = (
    '<RelativeDistanceCondition entityRef="Car" relativeDistanceType="cartesianDistance" '
    'freespace="false" value="25.0" rule="greaterOrEqual"/>'
)
REACH = (
    '<ReachPositionCondition tolerance="3.5"><Position><LanePosition roadId="1" laneId="-3" s="60" '
    'offset="0"/></Position></ReachPositionCondition>'
)
FASTER = '<RelativeSpeedCondition entityRef="Ego" value="2.0" rule="greaterThan"/>'
COLLISION = (
    '<TimeToCollisionCondition freespace="false" value="3.0" rule="lessOrEqual">'
    '<TimeToCollisionConditionTarget><EntityRef entityRef="Ego"/>'
    "</TimeToCollisionConditionTarget></TimeToCollisionCondition>"
)
LANE = '<AbsoluteTargetLane value="-2"/>'


def slow_down(shape="linear", dimension="rate", value=4.0, target=10.0):
    speed = f'<AbsoluteTargetSpeed value="{target}"/>'
    return SPEED.format(shape=shape, dimension=dimension, value=value, target=speed)


def change_lane(shape="cubic", dimension="time", value=2.0, target=None, offset=""):
    target = target or LANE
    return LATERAL.format(shape=shape, dimension=dimension, value=value, target=target, offset=offset)


def of_entity(condition, entity="Car"):
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{entity}"/>'
        f"</TriggeringEntities><EntityCondition>{condition}</EntityCondition></ByEntityCondition>"
    )


def event(action, condition=AT_ONE, name="first", edge="none", delay="0", priority="parallel"):
    return (
        f'<Event name="{name}" priority="{priority}"><Action name="act of {name}"><PrivateAction>{action}'
        f"</PrivateAction></Action><StartTrigger><ConditionGroup><Condition name='c' delay='{delay}' "
        f"conditionEdge='{edge}'>{condition}</Condition></ConditionGroup></StartTrigger></Event>"
    )


def init(name, position, speed):
    return (
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction><Position>{position}</Position>'
        f"</TeleportAction></PrivateAction><PrivateAction><LongitudinalAction><SpeedAction>{STEP}<SpeedActionTarget>"
        f'<AbsoluteTargetSpeed value="{speed}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>'
        "</PrivateAction></Private>"
    )


def lane_position(s, lane=-3, offset=0):
    return f'<LanePosition roadId="1" laneId="{lane}" s="{s}" offset="{offset}"/>'


def document(*events, car=None, ego=None, speed=20.0, ahead=0.0, actor="Car"):
    """Text of a scenario: the ego at 20 m/s in lane -2, a car in lane -3."""
    body = "".join(
        f'<ScenarioObject name="{name}">{CAR.format(ahead=ahead)}</ScenarioObject>' for name in ("Car", "Ego")
    )
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" description="" author=""/>
<ParameterDeclarations><ParameterDeclaration name="v" parameterType="double" value="{speed}"/>
<ParameterDeclaration name="lane" parameterType="integer" value="-2"/></ParameterDeclarations>
<RoadNetwork><LogicFile filepath="motorway.xodr"/></RoadNetwork><Entities>{body}</Entities>
<Storyboard><Init><Actions>
{init("Ego", ego or lane_position(10, -2), 20.0)}{init("Car", car or lane_position(30), "$v")}
</Actions></Init><Story name="s"><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors><Maneuver name="m">
{"".join(events)}
</Maneuver></ManeuverGroup></Act></Story><StopTrigger/></Storyboard></OpenSCENARIO>"""


@pytest.fixture
def build(tmp_path):
    def build(text, **options):
        for name in ("motorway.xodr",):
            (tmp_path / name).write_bytes((SCENARIOS / "openscenario" / name).read_bytes())
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return OpenScenario(OpenScenarioConfig(file=tmp_path / "scene.xosc", **options))

    return build


def drive(simulator, seconds, n=1, values=None):
    """States (T, N, ...) of the others, the ego going straight on."""
    world = simulator.reset_drawn(np.zeros((n, 0)), values or {})
    found = [world.others]
    for _ in range(round(seconds / simulator.dt)):
        world = simulator.step(world, Action(np.zeros(n), np.zeros(n)), np.zeros((n, 0)))
        assert not simulator.faults(world).any()
        found.append(world.others)
    return {name: np.stack([getattr(one, name) for one in found]) for name in vars(found[0])}


def test_the_shipped_road():
    roads = read_opendrive(str(SCENARIOS / "openscenario" / "motorway.xodr"))
    assert roads.road.lane_centres == (-8.75, -5.25, -1.75)
    assert roads.lanes == {-3: 0, -2: 1, -1: 2}
    assert [piece.end_curvature for piece in roads.line.pieces] == [0.0, 0.00125, 0.00125]


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
        (change_lane("sinusoidal", "distance", 40.0), 30, -5.25),
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
    assert (y[end:] == target).all()
    assert (heading[12:end] > 0.0).all()
    assert (heading[end + 1 :] == 0.0).all()
    slopes = np.diff(y) / 2.0  # 2 m a step
    aside = np.tan(heading[12:end]) - 0.5 * (slopes[12:end] + slopes[11 : end - 1])
    assert np.abs(aside).max() < 0.002


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
    assert found["y"][-1, 0, 0] == -5.25


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
    roads = read_opendrive(str(SCENARIOS / "openscenario" / "motorway.xodr"))
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


def test_a_parameter_that_names_a_lane_is_not_drawn(build):
    simulator = build(document(event(change_lane(target='<AbsoluteTargetLane value="$lane"/>'))))
    with pytest.raises(UsageError, match="'lane' is drawn"):
        simulator.drawing({"parameters.lane": None})


def test_what_the_ego_is_told_to_do_is_refused_or_passed_over(build):
    text = document(event(slow_down()), actor="Ego")
    with pytest.raises(UsageError, match="driven by the controller") as caught:
        build(text)
    assert "ignore_ego_events" in caught.value.hint
    assert (drive(build(text, ignore_ego_events=True), 3.0)["speed"] == 20.0).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<LaneChangeTarget>", '<LaneChangeTarget old="1">', "LaneChangeTarget: the attribute old is not"),
        ("cubic", "quartic", r"dynamicsShape should be one of step, .*'quartic'"),
        (LANE, LANE.replace("2", "9"), "there is no lane -9"),
        ('value="2.0"/><LaneChange', 'value="$w"/><LaneChange', "no parameter 'w' is declared"),
        ('value="2.0"/><LaneChange', 'value="${import(1)}"/><LaneChange', "neither a number nor an"),
        ("LaneChangeAction>", "FollowTrajectoryAction>", "FollowTrajectoryAction: is not read"),
        ("LateralAction>", "RoutingAction>", "RoutingAction: is not read"),
        ("</Act></Story>", "</Act><Act name='b'><StartTrigger/></Act></Story>", "has no condition"),
        ('entityRef="Car"', 'entityRef="Cat"', "there is no entity 'Cat'"),
        ('revMajor="1"', 'revMajor="2"', r"only OpenSCENARIO XML 1\.x"),
        ('laneId="-3"', 'laneId="0"', "nobody drives on lane 0|there is no lane 0"),
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
        ('a="3.5" b="0.0"', 'a="3.5" b="0.1"', r"width: changes along the road"),
        ('<arc curvature="0.00125"/>', '<poly3 a="0" b="0" c="0" d="0"/>', r"poly3: is not read"),
        ('rule="RHT"', 'rule="LHT"', r"traffic on the left"),
        (
            "<link/>",
            '<link><successor elementType="junction" elementId="7"/></link>',
            r"successor: .*junction '7'",
        ),
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


def state_of(kind, name, state):
    return (
        f'<ByValueCondition><StoryboardElementStateCondition storyboardElementType="{kind}" '
        f'storyboardElementRef="{name}" state="{state}"/></ByValueCondition>'
    )


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


def test_references_that_are_not_clear_are_refused(build):
    last = event(slow_down(), state_of("event", "first", "completeState"), "second")
    with pytest.raises(UsageError, match="there are 2 elements event 'first'"):
        build(document(event(change_lane()), event(change_lane()), last))
    both = event(change_lane()).replace("<StartTrigger>", f"<Action name='b'>{ACTION}</Action><StartTrigger>")
    for state in ("completeState", "runningState"):
        last = event(slow_down(), state_of("action", "b", state), "second")
        with pytest.raises(UsageError, match="one action among several"):
            build(document(both, last))


ACTION = f"<PrivateAction>{slow_down()}</PrivateAction>"


def test_a_step_over_a_distance_takes_no_time(build):
    text = document(
        event(slow_down("step", "distance", 60.0)),
        event(change_lane(), state_of("event", "first", "completeState"), "second"),
    )
    found = drive(build(text), 2.0)
    np.testing.assert_allclose(found["x"][11, 0, 0] - found["x"][10, 0, 0], 1.0)
    assert np.flatnonzero(found["y"][:, 0, 0] != -8.75)[0] == 12


EUCLIDEAN = COLLISION.replace("freespace", 'relativeDistanceType="euclidianDistance" freespace')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document(event(slow_down(value=-4.0))), r"Dynamics: value should be at least 0, found -4"),
        (document(event(slow_down(target=-1.0))), r"AbsoluteTargetSpeed: value should be at least 0"),
        (document(event(slow_down()), speed=-3.0), r"AbsoluteTargetSpeed: value should be at least 0"),
        (document(event(slow_down(value="${1e-400 * 4 / 0}"))), "no finite number"),
        (document(event(slow_down(value="${1 * " + "9" * 320 + "}"))), "neither a number nor"),
        (document(event(slow_down(), of_entity(EUCLIDEAN))), "time to collision is read along the road"),
        (document(event(slow_down(), of_entity(GAP.replace("true", "yes")))), "freespace should be true or"),
        (document(car=lane_position(5000.0)), r"'Car' begins at 5000 m of its road"),
        (document(car=lane_position(-1.0)), r"'Car' begins at -1 m of its road"),
        (document().replace('y="0" z="0"/>', 'y="0.2" z="0"/>'), "middle of the vehicle: y = 0"),
    ],
)
def test_numbers_that_cannot_be(build, text, message):
    with pytest.raises(UsageError, match=message):
        build(text)


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


@pytest.mark.parametrize("name", ["x", "heading", "speed", "length", "width"])
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
        ("parameters.EgoSpeed=-2", r"value should be at least 0, found -2"),
        ("parameters.EgoSpeed=.nan", r"EgoSpeed"),
        ("ego.speed=3", r"ego\.speed: that of the ego is given"),
    ],
)
def test_options_that_cannot_be(option, message):
    with pytest.raises(AvrareError, match=message):
        build_stack(load(SCENARIOS / "cut_in.yaml", [f"simulator.{option}"]))


def test_two_distributions_of_one_parameter(tmp_path):
    text = (SCENARIOS / "openscenario" / "cut_in_distributions.xosc").read_text(encoding="utf-8")
    path = tmp_path / "two.xosc"
    path.write_text(text.replace('"CutInSpeed"', '"EgoSpeed"'), encoding="utf-8")
    with pytest.raises(UsageError, match=r"two\.xosc:12:\d+: .*second distribution of 'EgoSpeed'"):
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
