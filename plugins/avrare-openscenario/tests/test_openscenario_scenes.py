"""The command ``avrare scenes``, and scenes that are acted out without a stack."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import ExitCode
from avrare.cli.main import Parser
from avrare_openscenario import scenes_command
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.scenes_command import judge_scene, list_scenes, read_acted
from avrare_openscenario.trace import act_out
from openscenario_files import (
    AT_ONE,
    COLLISION,
    SCENARIOS,
    SPEED,
    change_lane,
    document,
    event,
    lane_position,
    of_entity,
    slow_down,
    state_of,
    straight,
)

DATA = next(
    (
        folder / "shared" / "data" / "openscenario"
        for folder in Path(__file__).parents
        if (folder / "shared" / "data" / "openscenario").is_dir()
    ),
    None,
)
READ_BY_NOW = 159
"""Least number of the given scenes that are read."""


@pytest.fixture
def write(tmp_path):
    def write(text, road=None):
        motorway = SCENARIOS / "openscenario" / "motorway.xodr"
        (tmp_path / "motorway.xodr").write_text(
            motorway.read_text(encoding="utf-8") if road is None else road, encoding="utf-8"
        )
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return str(tmp_path / "scene.xosc")

    return write


def run(capsys, *words):
    parser = Parser()
    scenes_command.add_arguments(parser)
    code = scenes_command.execute(parser.parse_args(words))
    return code, capsys.readouterr().out


def follow(vertices, timing="<None/>"):
    points = "".join(
        f'<Vertex time="{time}"><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>'
        for time, x, y in vertices
    )
    return (
        "<RoutingAction><FollowTrajectoryAction><Trajectory name='t' closed='false'><Shape>"
        f"<Polyline>{points}</Polyline></Shape></Trajectory><TimeReference>{timing}</TimeReference>"
        "<TrajectoryFollowingMode followingMode='position'/></FollowTrajectoryAction></RoutingAction>"
    )


TIMED = '<Timing domainAbsoluteRelative="relative" scale="1.0" offset="0.0"/>'


def with_private(text, action, entity="Car"):
    """Return the text with one more action of an entity in ``Init``."""
    mark = f'<Private entityRef="{entity}">'
    at = text.index("</Private>", text.index(mark))
    return text[:at] + f"<PrivateAction>{action}</PrivateAction>" + text[at:]


def states_of(path, name, until, dt=0.05):
    file = read_acted(path, dt)
    times, states = act_out(file, dt, until)
    return times, states[:, [body.name for body in file.bodies].index(name)].T


def test_the_three_judgements(write, capsys, tmp_path):
    path = write(document(event(change_lane())))
    assert judge_scene(path).status == "read"
    lights = "<AppearanceAction><LightStateAction/></AppearanceAction>"
    noted = judge_scene(write(document(event(lights))))
    assert (noted.status, noted.line) == ("notes", None)
    assert "lights and animations change nothing" in noted.reason
    text = document(event(change_lane())).replace("LaneChangeTarget>", "LaneGoal>")
    refused = judge_scene(write(text))
    assert refused.status == "refused"
    assert refused.line == 1 + text[: text.index("<LaneChangeAction")].count("\n")
    assert {"LaneChangeAction", "SimulationTimeCondition", "LanePosition"} <= set(refused.features)
    code, out = run(capsys, "--json", str(tmp_path))
    (entry,) = json.loads(out)
    assert code == ExitCode.FAIL
    assert set(entry) == {"file", "status", "reason", "line", "features"}
    code, out = run(capsys, write(document()))
    assert (code, out.splitlines()[-1]) == (ExitCode.PASS, "1 scenes: 1 read, 0 notes, 0 refused")


def test_a_trace_has_all_states_and_the_ego_obeys(write, tmp_path, capsys):
    path = write(document(event(slow_down(shape="step", target=10.0)), actor="Ego"))
    out = str(tmp_path / "out.csv")
    assert run(capsys, path, "--trace", out, "--dt", "0.1", "--until", "2")[0] == ExitCode.PASS
    with open(out, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 21
    last = [row for row in rows if row["entity"] == "Ego"][-1]
    assert float(last["time"]) == 2.0
    assert float(last["speed"]) == 10.0
    assert float(last["x"]) == pytest.approx(10.0 + 20.0 + 10.0, abs=0.01)


def test_a_speed_that_follows_another_goes_on(write):
    target = (
        '<RelativeTargetSpeed entityRef="Ego" value="-2" speedTargetValueType="delta" continuous="true"/>'
    )
    chase = SPEED.format(shape="linear", dimension="time", value=1.0, target=target)
    text = document(event(chase))
    brake = event(slow_down(shape="step", target=5.0), AT_ONE.replace("1.0", "4.0"), "brake")
    group = text[text.index("<ManeuverGroup") : text.index("</ManeuverGroup>") + len("</ManeuverGroup>")]
    second = group.replace('"Car"', '"Ego"').replace(event(chase), brake).replace('"m"', '"n"')
    times, (_, _, _, speed) = states_of(write(text.replace(group, group + second)), "Car", 6.0)
    assert speed[times < 0.9] == pytest.approx(20.0)
    assert speed[(times > 2.2) & (times < 3.9)] == pytest.approx(18.0)
    assert speed[times > 4.2] == pytest.approx(3.0)


def test_a_distance_at_the_start_counts_the_speed_of_the_other(write):
    gap = (
        '<LongitudinalAction><LongitudinalDistanceAction entityRef="Ego" timeGap="1.5" freespace="true" '
        'continuous="false" displacement="leadingReferencedEntity"/></LongitudinalAction>'
    )
    _, (x, _, _, speed) = states_of(write(with_private(document(speed=3.0), gap)), "Car", 1.0)
    assert x[0] == pytest.approx(10.0 + 1.5 * 20.0 + 4.5)
    assert speed == pytest.approx(20.0)


def test_trajectories_by_time_and_at_the_own_speed(write):
    path = [(0.0, 30.0, -8.75), (2.0, 50.0, -8.75), (3.0, 50.0, -1.75)]
    times, (x, y, heading, speed) = states_of(write(document(event(follow(path, TIMED)))), "Car", 3.9)
    second = np.argmin(np.abs(times - 2.0))
    assert (x[second], y[second]) == pytest.approx((40.0, -8.75), abs=1e-6)
    assert speed[second] == pytest.approx(10.0)
    later = np.argmin(np.abs(times - 3.5))
    assert (x[later], y[later], heading[later]) == pytest.approx((50.0, -5.25, math.pi / 2), abs=1e-6)
    _, (x, y, _, speed) = states_of(write(document(event(follow(path)))), "Car", 1.5)
    assert (x[-1], speed[-1]) == pytest.approx((40.0, 20.0), abs=1e-6)


def test_constraints_and_derived_parameters(write):
    declared = '<ParameterDeclaration name="lane"'
    derived = '<ParameterDeclaration name="w" parameterType="double" value="${2 * $v - cos(0)}"/>' + declared
    text = document(event(slow_down(shape="step", target="$w"))).replace(declared, derived)
    assert states_of(write(text), "Car", 2.0)[1][3][-1] == 39.0
    group = (
        '<ConstraintGroup><ValueConstraint rule="{}" value="10"/></ConstraintGroup></ParameterDeclaration>'
    )
    bounded = text.replace('value="20.0"/><', 'value="20.0">{}<', 1)
    for rule, status in (("greaterThan", "read"), ("lessThan", "refused")):
        old = 'parameterType="double" value="20.0"/>'
        assert old in text
        bounded = text.replace(old, old[:-2] + ">" + group.format(rule), 1)
        found = judge_scene(write(bounded))
        assert (found.status, "ConstraintGroup" in found.reason) == (status, status == "refused")


def test_events_that_repeat_and_variables(write):
    declare = '<VariableDeclarations><VariableDeclaration name="n" variableType="integer" value="0"/>'
    add = (
        '<Action name="count"><GlobalAction><VariableAction variableRef="n"><ModifyAction><Rule>'
        '<AddValue value="1"/></Rule></ModifyAction></VariableAction></GlobalAction></Action>'
    )
    asks = (
        '<ByValueCondition><VariableCondition variableRef="n" value="3" rule="equalTo"/></ByValueCondition>'
    )
    count = event(slow_down(shape="step", target=10.0)).replace("<StartTrigger>", add + "<StartTrigger>")
    count = count.replace('priority="parallel"', 'priority="parallel" maximumExecutionCount="3"')
    stop = event(slow_down(shape="step", target=1.0), asks, "stop")
    text = document(count, stop).replace("<RoadNetwork>", declare + "</VariableDeclarations><RoadNetwork>")
    assert states_of(write(text), "Car", 2.0)[1][3][-1] == 1.0
    twice = text.replace('maximumExecutionCount="3"', 'maximumExecutionCount="2"')
    assert states_of(write(twice), "Car", 2.0)[1][3][-1] == 10.0


def test_an_act_ends_with_its_stop_trigger(write):
    late = '<ByValueCondition><SimulationTimeCondition value="2.0" rule="greaterOrEqual"/></ByValueCondition>'
    condition = f"<Condition name='e' delay='0'>{late}</Condition>"
    stop = f"<StopTrigger><ConditionGroup>{condition}</ConditionGroup></StopTrigger>"
    text = document(event(slow_down(dimension="time", value=5.0)))
    _, (_, _, _, speed) = states_of(write(text.replace("</Act>", stop + "</Act>")), "Car", 5.0)
    assert speed[-1] == pytest.approx(18.0, abs=0.2)


def test_borders_that_change_and_polynomials(tmp_path):
    text = (SCENARIOS / "openscenario" / "motorway.xodr").read_text(encoding="utf-8")
    width = '<width sOffset="0.0" a="3.5" b="0.0"'
    assert width in text
    path = tmp_path / "road.xodr"
    path.write_text(text.replace(width, width.replace('b="0.0"', 'b="0.01"'), 1), encoding="utf-8")
    (roads,) = read_opendrive(str(path)).maps
    widths = [lane.left - lane.right for lane in roads.road.lanes]
    wider = [change for change in widths if np.ptp(change) > 0.1]
    assert len(wider) == 1
    assert wider[0][-1] == pytest.approx(3.5 + 0.01 * roads.line.length)


def test_a_polynomial_is_a_parabola(tmp_path):
    road = """<OpenDRIVE><header revMajor="1" revMinor="4"/><road name="" length="50" id="1" junction="-1">
<planView><geometry s="0" x="0" y="0" hdg="0" length="50"><paramPoly3 aU="0" bU="1" cU="0" dU="0" aV="0"
bV="0" cV="0.001" dV="0" pRange="arcLength"/></geometry></planView><lanes><laneSection s="0"><center>
<lane id="0" type="none" level="false"/></center><right><lane id="-1" type="driving" level="false">
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>"""
    path = tmp_path / "road.xodr"
    path.write_text(road, encoding="utf-8")
    (roads,) = read_opendrive(str(path)).maps
    x, y, heading, _ = roads.line.frame(np.array([roads.line.length]))
    assert (x[0], y[0]) == pytest.approx((50.0, 2.5))
    assert heading[0] == pytest.approx(math.atan(0.1), abs=2e-3)


def two_ways():
    """Return roads 1, then by a junction 2 (straight on) or 3 (which bends away), then 4 after 3."""
    after = '<successor elementType="road" elementId="4" contactPoint="start"/>'
    ways = "".join(
        f'<connection id="{way}" incomingRoad="1" connectingRoad="{way}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        for way in (2, 3)
    )
    bend = straight(3, 50.0, 0.0, 0.0, after, length=20.0, junction="7")
    roads = (
        straight(1, 0.0, 0.0, 0.0, '<successor elementType="junction" elementId="7"/>'),
        straight(2, 50.0, 0.0, 0.0, junction="7"),
        bend.replace("<line/>", '<arc curvature="0.05"/>'),
        straight(4, 50.0 + 20.0 * math.sin(1.0), 20.0 * (1.0 - math.cos(1.0)), 1.0),
    )
    return f'<OpenDRIVE><header/>{"".join(roads)}<junction id="7" name="">{ways}</junction></OpenDRIVE>'


def route_to(*roads):
    points = "".join(
        f'<Waypoint routeStrategy="shortest"><Position><LanePosition roadId="{road}" laneId="-1" s="5"/>'
        "</Position></Waypoint>"
        for road in roads
    )
    route = f"<RoutingAction><AssignRouteAction><Route name='r' closed='false'>{points}</Route>"
    return route + "</AssignRouteAction></RoutingAction>"


def test_a_vehicle_drives_straight_on_or_along_its_route(write):
    text = document(car=lane_position(10.0, -1), ego=lane_position(30.0, -1))
    _, (x, y, heading, _) = states_of(write(text, two_ways()), "Car", 4.0)
    assert (x[-1], y[-1], heading[-1]) == pytest.approx((90.0, -1.75, 0.0), abs=1e-6)
    routed = with_private(text, route_to(1, 4))
    _, (x, y, heading, _) = states_of(write(routed, two_ways()), "Car", 4.0)
    way = 90.0 - 50.0 - 20.0 - 1.75 * 1.0  # on road 4: the outer lane of the bend is longer
    corner = 50.0 + 20.0 * math.sin(1.0), 20.0 * (1.0 - math.cos(1.0))
    there = (
        corner[0] + way * math.cos(1.0) + 1.75 * math.sin(1.0),
        corner[1] + way * math.sin(1.0) - 1.75 * math.cos(1.0),
    )
    assert (x[-1], y[-1]) == pytest.approx(there, abs=0.02)
    assert heading[-1] == pytest.approx(1.0, abs=1e-3)


def test_one_action_of_an_event_ends_before_the_other(write):
    both = event(change_lane("linear", "time", 4.0)).replace(
        "<StartTrigger>",
        f"<Action name='b'><PrivateAction>{slow_down(shape='linear', dimension='time', value=1.0)}"
        "</PrivateAction></Action><StartTrigger>",
    )
    last = event(slow_down(shape="step", target=3.0), state_of("action", "b", "completeState"), "second")
    times, (_, _, _, speed) = states_of(write(document(both, last)), "Car", 4.0)
    assert times[np.argmax(speed < 4.0)] == pytest.approx(2.05, abs=0.051)


def test_a_maneuver_group_is_executed_again(write):
    pair = (
        event(slow_down(shape="step", target=10.0)),
        event(slow_down(shape="step", target=20.0), state_of("event", "first", "completeState"), "second"),
    )
    text = document(*pair)
    speeds = [
        states_of(
            write(text.replace('maximumExecutionCount="1"', f'maximumExecutionCount="{n}"', 1)), "Car", 3.0
        )[1][3]
        for n in (1, 3)
    ]
    assert [int((np.diff(speed) < 0.0).sum()) for speed in speeds] == [1, 3]


def test_a_scene_without_a_road_is_acted_out_in_the_plane(write):
    text = document(event(follow([(0.0, 0.0, 0.0), (1.0, 10.0, 0.0), (2.0, 10.0, 10.0)], TIMED)))
    text = text.replace('<LogicFile filepath="motorway.xodr"/>', "")
    for lane, y in ((-2, 5), (-3, 0)):
        start = lane_position(10 if lane == -2 else 30, lane)
        assert start in text
        text = text.replace(start, f'<WorldPosition x="0" y="{y}" h="0.5"/>')
    path = write(text)
    assert "open plane" in judge_scene(path).reason
    _, (x, y, heading, _) = states_of(path, "Ego", 1.0)
    assert (x[-1], y[-1], heading[-1]) == pytest.approx((20 * math.cos(0.5), 5 + 20 * math.sin(0.5), 0.5))
    times, (x, y, heading, _) = states_of(path, "Car", 3.0)
    turning = np.argmin(np.abs(times - 2.0))  # the trajectory begins at 1 s: half-way around the corner
    assert (x[turning], y[turning], heading[turning]) == pytest.approx((10.0, 0.0, math.pi / 4), abs=1e-6)


def test_nobody_beside_is_a_clearance(write):
    clear = (
        '<RelativeClearanceCondition distanceForward="{}" distanceBackward="30" freeSpace="true" '
        'oppositeLanes="false"><RelativeLaneRange from="1" to="1"/></RelativeClearanceCondition>'
    )
    for reach, target in ((10.0, 20.0), (4.0, 5.0)):
        text = document(
            event(slow_down(shape="step", target=5.0), of_entity(clear.format(reach))), speed=20.0
        )
        text = text.replace(lane_position(30), lane_position(0.5))
        assert states_of(write(text), "Car", 1.0)[1][3][-1] == target


def test_a_route_that_begins_later_holds_at_the_next_junction(write):
    text = document(event(route_to(4)), car=lane_position(10.0, -1), ego=lane_position(30.0, -1))
    _, (_, y, heading, _) = states_of(write(text, two_ways()), "Car", 4.0)
    assert heading[-1] == pytest.approx(1.0, abs=1e-3)
    assert y[-1] > 5.0


def test_lanes_of_the_road_that_a_vehicle_is_on_count_after_a_junction(write):
    late = AT_ONE.replace("1.0", "2.5")
    change = event(change_lane(target='<AbsoluteTargetLane value="1"/>'), late)
    text = document(change, car=lane_position(10.0, -1), ego=lane_position(30.0, -1))
    _, (x, y, _, _) = states_of(write(text, two_ways()), "Car", 6.0)
    assert x[-1] > 60.0
    assert y[-1] == pytest.approx(1.75, abs=1e-6)


@pytest.mark.skipif(DATA is None, reason="the recorded trajectories are not here")
def test_the_census_does_not_fall():
    roads = [
        path for path in list_scenes([str(DATA)]) if "LogicFile" in Path(path).read_text(errors="ignore")
    ]
    findings = [judge_scene(path) for path in roads]
    assert sum(finding.status != "refused" for finding in findings) >= READ_BY_NOW
    assert all(finding.reason for finding in findings if finding.status == "refused")


@pytest.mark.parametrize(("value", "noted"), [("0.0", True), ("1.0", False)])
def test_a_rising_edge_that_holds_at_its_first_check_is_noted(write, value, noted):
    now = AT_ONE.replace('value="1.0"', f'value="{value}"')
    found = judge_scene(write(document(event(slow_down(), now, edge="rising"))))
    assert ("a rising edge that holds at its first check" in found.reason) == noted


def test_a_time_to_collision_across_lanes_is_noted(write):
    found = judge_scene(write(document(event(slow_down(), of_entity(COLLISION)))))
    assert "is taken along the road, also to vehicles in other lanes" in found.reason
