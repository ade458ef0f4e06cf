"""Scenes that are acted out without a stack: distances across, ends of trajectories, tilted roads."""

import numpy as np
import pytest

from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.scenes_command import read_acted
from avrare_openscenario.trace import act_out
from openscenario_files import change_lane, document, event, lane_position, slow_down, straight

ROADS = straight(1, 0.0, 0.0, 0.0, length=400.0) + straight(2, 150.0, 20.0, 0.5 * np.pi, length=200.0)
BESIDE = (
    '<LateralAction><LateralDistanceAction entityRef="Ego" distance="2" freespace="false" continuous="false" '
    'displacement="leftToReferencedEntity" coordinateSystem="{}">{}</LateralDistanceAction></LateralAction>'
)
CORNER = "".join(
    f'<Vertex><Position><WorldPosition x="{x}" y="{y}"/></Position></Vertex>'
    for x, y in ((50.0, -1.75), (151.75, -1.75), (151.75, 40.0))
)
TURN = (
    '<RoutingAction><FollowTrajectoryAction><Trajectory name="t" closed="false"><Shape>'
    f"<Polyline>{CORNER}</Polyline></Shape></Trajectory><TimeReference><None/></TimeReference>"
    '<TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction></RoutingAction>'
)
AHEAD = '<RelativeRoadPosition entityRef="Car" ds="5" dt="0"/>'


@pytest.fixture
def act(tmp_path):
    """Return the states (T, 4) of the car beside an ego that drives along y = -1.75 of road 1."""

    def act(action, seconds, performance=""):
        (tmp_path / "motorway.xodr").write_text(f"<OpenDRIVE><header/>{ROADS}</OpenDRIVE>", encoding="utf-8")
        text = document(event(action), ego=lane_position(10, -1), car=lane_position(30, -1))
        text = text.replace("</BoundingBox>", f"</BoundingBox>{performance}")
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return act_out(read_acted(str(tmp_path / "scene.xosc"), 0.1), 0.1, seconds)[1][:, 0]

    return act


def test_a_distance_across_the_road_is_closed_at_the_highest_speed(act):
    x, y, heading, _ = act(BESIDE.format("road", '<DynamicConstraints maxSpeed="2"/>'), 2.5).T
    np.testing.assert_allclose(y[11:14], [-1.75, -1.55, -1.35])
    np.testing.assert_allclose(y[21:], 0.25)
    np.testing.assert_allclose(heading[12:21], np.arcsin(0.1))
    np.testing.assert_allclose(np.diff(x)[11:20], np.sqrt(2.0**2 - 0.2**2))


def test_a_distance_beside_a_body_is_reached_by_turns_of_the_highest_acceleration(act):
    _, y, heading, speed = act(BESIDE.format("entity", '<DynamicConstraints maxAcceleration="3"/>'), 10.0).T
    turns = np.abs(np.diff(heading)) / 0.1
    assert turns.max() * 20.0 <= 1.5 * 3.0 / 1.5 + 1e-9
    assert heading[15] > 0.02
    assert y[15] > -1.75
    assert abs(y[-1] - 0.25) < 0.1
    assert (speed == 20.0).all()


def test_after_a_trajectory_a_vehicle_drives_along_the_road_where_it_is(act):
    x, y, heading, _ = act(TURN, 10.0).T
    np.testing.assert_allclose(x[-10:], 151.75, atol=1e-6)
    np.testing.assert_allclose(heading[-10:], 0.5 * np.pi)
    np.testing.assert_allclose(np.diff(y)[-9:], 2.0)


def test_who_is_put_to_a_place_goes_no_way_in_that_step(act):
    np.testing.assert_allclose(
        np.diff(act(f"<TeleportAction><Position>{AHEAD}</Position></TeleportAction>", 1.3)[9:, 0]),
        [2.0, 5.0, 2.0, 2.0],
    )


def test_a_top_speed_is_kept(act):
    limits = '<Performance maxSpeed="50" maxAcceleration="9" maxDeceleration="9"/>'
    assert act(slow_down("step", "time", 0.0, target=1e3), 1.2, limits)[-1, 3] == 50.0


def test_an_offset_costs_no_way(act):
    offset = (
        '<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics maxLateralAcc="4" '
        'dynamicsShape="sinusoidal"/>'
        '<LaneOffsetTarget><AbsoluteTargetLaneOffset value="1"/></LaneOffsetTarget>'
        "</LaneOffsetAction></LateralAction>"
    )
    change = change_lane(target='<AbsoluteTargetLane value="1"/>')
    ways = [np.diff(act(action, 2.0)[:, 0]) for action in (offset, change)]
    np.testing.assert_allclose(ways[0], 2.0)
    assert ways[1].min() < 2.0


def test_slopes_and_banks_are_seen_from_above(tmp_path):
    profile = '<elevationProfile><elevation s="0" a="0" b="0.75" c="0" d="0"/></elevationProfile>'
    bank = '<lateralProfile><superelevation s="0" a="-0.5" b="0" c="0" d="0"/></lateralProfile>'
    pose = np.array([50.0]), np.array([-4.0]), np.array([0.4])
    seen = []
    for block in ("", profile, bank):
        path = tmp_path / "road.xodr"
        road = straight(1, 0.0, 0.0, 0.0).replace("<lanes>", f"{block}<lanes>")
        path.write_text(f"<OpenDRIVE><header/>{road}</OpenDRIVE>", encoding="utf-8")
        seen.append(np.concatenate(read_opendrive(str(path)).maps[0].see_from_above(*pose)))
    np.testing.assert_allclose(seen[0], [50.0, -4.0, 0.4])
    np.testing.assert_allclose(seen[1], [50.0, -4.0, np.arctan(np.tan(0.4) / 0.8)])
    np.testing.assert_allclose(seen[2], [50.0, -4.0 * np.cos(0.5), np.arctan(np.tan(0.4) * np.cos(0.5))])


@pytest.mark.parametrize(
    ("tag", "height", "noted"), [("shape", 1, True), ("shape", 0, False), ("superelevation", 0, False)]
)
def test_profiles_that_are_not_flat_are_noted(tag, height, noted, tmp_path):
    profile = f'<lateralProfile><{tag} s="0" t="0" a="{height}" b="0" c="0" d="0"/></lateralProfile>'
    path = tmp_path / "road.xodr"
    road = straight(1, 0.0, 0.0, 0.0).replace("<lanes>", f"{profile}<lanes>")
    path.write_text(f"<OpenDRIVE><header/>{road}</OpenDRIVE>", encoding="utf-8")
    assert any("flat road" in note for note in read_opendrive(str(path)).notes) == noted
