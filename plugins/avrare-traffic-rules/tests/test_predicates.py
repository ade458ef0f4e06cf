"""Every predicate where sign and value can be told by hand.

Units: 10 m along the road, 1.75 m across it, 5 m/s, 2 m/s^2, 0.1 rad.
"""

import numpy as np
import pytest

from avrare.driving import Lane, Road
from avrare.driving.reference_line import CurvedLine, Piece
from avrare_traffic_rules.definitions import RECOMMENDED

AHEAD = {"x": 24.0}


def near(expected):
    return pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ({"x": 24.0}, 20.0 / 10.0),  # 24 m between centres, 20 between bumpers
        ({"x": 4.0}, 0.0),
        ({"x": 3.0}, -0.1),
        ({"x": -24.0}, -28.0 / 10.0),
        # turned across the road, o begins 1 m, not 2 m, before its centre
        ({"x": 24.0, "heading": np.pi / 2}, 21.0 / 10.0),
    ],
)
def test_in_front_of(value, other, expected):
    assert value("in_front_of", other) == near(expected)


@pytest.mark.parametrize(
    ("y", "ego_y", "expected"),
    [
        (1.75, 1.75, (1.75 + 1.0) / 1.75),  # both mid-lane: half the lane and half the car
        (5.25, 1.75, (2.75 - 3.5) / 1.75),  # adjacent lanes, each 0.75 m inside its own
        (4.4, 1.75, (2.75 - 2.65) / 1.75),  # o still reaches 0.1 m into the ego's lane
        (5.25, 2.6, (2.75 - 2.65) / 1.75),  # ... or the ego into its
        (-1.75, 5.25, (2.75 - 3.5) / 1.75),  # between them in the middle lane
    ],
)
def test_in_same_lane(value, y, ego_y, expected):
    assert value("in_same_lane", {"y": y}, y=ego_y) == near(expected)


def test_a_turned_car_reaches_farther_across(value):
    # 4 m x 2 m at 30 degrees: half extent (2 sin 30 + 1 cos 30) m
    expected = (1.75 + 2.0 * 0.5 + np.cos(np.pi / 6) - 3.5) / 1.75
    assert value("in_same_lane", {"y": 5.25, "heading": np.pi / 6}) == near(expected)
    assert expected > 0.0


@pytest.mark.parametrize(
    ("y", "expected"), [(1.75, 0.75 / 1.75), (2.6, -0.1 / 1.75), (3.5, -1.0 / 1.75), (9.0, -1.0 / 1.75)]
)
def test_single_lane(value, y, expected):
    assert value("single_lane", {"y": y}) == near(expected)


@pytest.mark.parametrize(
    ("y", "heading", "expected"),
    [
        (3.5, -0.05, 0.5),  # from the left, turning right: the heading is the least
        (3.5, -1e-3, 0.01),
        (3.5, 0.05, -0.5),  # from the left but turning left
        (0.0, 0.05, 0.5),  # from the right, turning left
        (0.0, -0.05, -0.5),
        (5.25, -0.05, -0.3722),  # still alone in its lane: not cutting in yet
    ],
)
def test_cut_in(value, y, heading, expected):
    assert value("cut_in", {"y": y, "heading": heading}) == pytest.approx(expected, abs=1e-4)


def test_keeps_safe_distance(value):
    # ego 20 m/s: 400 / 20 = 20 m, o 10 m/s: 100 / 21 m, reaction 20 * 0.4 = 8 m
    needed = 20.0 - 100.0 / 21.0 + 8.0
    assert value("keeps_safe_distance", {"x": 24.0, "speed": 10.0}) == near((20.0 - needed) / 10.0)
    assert value("keeps_safe_distance", {"x": 40.0, "speed": 10.0}) == near((36.0 - needed) / 10.0)
    # a faster o needs no room at all, but not less than none
    assert value("keeps_safe_distance", {"x": 14.0, "speed": 40.0}) == near(1.0)


def test_precedes_is_the_nearest_ahead_in_the_lane(value):
    behind, near_one, far, left = {"x": -20.0}, {"x": 24.0}, {"x": 34.0}, {"x": 14.0, "y": 5.25}
    found = value("precedes", behind, far, near_one, left)
    assert (found > 0.0).tolist() == [False, False, True, False]
    assert found[2] == near(0.75 / 1.75)  # the left one would have to come that much nearer
    assert found[1] == near(-1.0)
    assert value("precedes", near_one) == near(2.75 / 1.75)
    assert value("precedes", near_one, far)[0] == near(1.0)  # by the 10 m between the two


def test_braking(value):
    assert value("brakes_abruptly", AHEAD, acceleration=-3.0) == near(0.5)
    assert value("brakes_abruptly", AHEAD, acceleration=-1.0) == near(-0.5)
    others = [{"acceleration": a} for a in (-2.0, 0.0, 2.0)]
    relative = value("brakes_abruptly_relative", *others, acceleration=-3.0)
    np.testing.assert_allclose(relative, [-0.5, 0.5, 0.5], atol=1e-12)  # o's own accelerating is no excuse


def test_speeds(value):
    assert value("slow", {"speed": 16.11}) == near(1.0)  # 36.11 - 15 = 21.11
    assert value("slow", {"speed": 26.11}) == near(-1.0)
    assert value("preserves_flow", AHEAD, speed=26.11) == near(1.0)
    assert value("preserves_flow", AHEAD, speed=16.11) == near(-1.0)
    assert value("drives_faster", {"speed": 15.0}) == near(1.0)
    assert value("drives_faster", {"speed": 25.0}) == near(-1.0)
    assert value("drives_slightly_faster", {"speed": 19.0}) == near(4.55 / 5.0)
    assert value("drives_slightly_faster", {"speed": 14.0}) == near(-0.45 / 5.0)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ({"x": 0.0, "y": 5.25}, 4.0 / 10.0),  # alongside: 4 m of overlap along, 1.5 m aside
        ({"x": 3.0, "y": 5.25}, 1.0 / 10.0),
        ({"x": 5.0, "y": 5.25}, -1.0 / 10.0),
        ({"x": -3.0, "y": 5.25}, 1.0 / 10.0),
        ({"x": 0.0, "y": 3.85}, 0.1 / 1.75),
        ({"x": 0.0, "y": 3.65}, -0.1 / 1.75),
        ({"x": 0.0, "y": -1.75}, -5.5 / 1.75),  # to the right
    ],
)
def test_left_of(value, other, expected):
    assert value("left_of", other) == near(expected)


def test_each_kind_of_slow_traffic_has_its_own_speed_and_size(value):
    row = [{"x": 10.0 * k, "speed": 2.0} for k in range(4)]
    for kind, limit in [("in_congestion", 2.78), ("in_slow_moving_traffic", 8.33), ("in_queue", 16.67)]:
        expected, last = near(min((limit - 2.0) / 5.0, 0.6)), {**row[0], "x": 40.0, "speed": limit}
        assert value(f"{kind}(a)", *row) == value(f"{kind}(a)", *row, last) == expected
        assert value(f"{kind}(a)", *row[:3], {**row[3], "speed": limit + 1.0}) == near(-0.2)
    options = {"queue_size": 9, "slow_traffic_size": 9, "congestion_size": 2}
    assert value("in_slow_traffic(a)", *row, options=options) == near((2.78 - 2.0) / 5.0)


def test_the_ego_counts_in_no_queue(value):
    pair = [{"x": 20.0 * k, "speed": 1.0} for k in range(3)]
    assert value("in_queue(a)", *pair, x=10.0, speed=1.0) == -np.inf


def test_ramp_and_carriageway(value):
    assert value("on_access_ramp", AHEAD, y=-1.75) == near(2.75 / 1.75)
    assert value("on_access_ramp", AHEAD, y=1.75) == near(-0.75 / 1.75)
    assert value("on_access_ramp", AHEAD, y=0.9) == near(0.1 / 1.75)  # one side is on it
    assert value("on_main_carriageway", {"y": 1.75}) == near(2.75 / 1.75)
    assert value("on_main_carriageway", {"y": -1.75}) == near(-0.75 / 1.75)


def test_roads_without_a_ramp_or_nothing_but_a_ramp(value):
    for ramp, on_ramp, on_main in [((), -np.inf, 2.75 / 1.75), ((0, 1), 2.75 / 1.75, -np.inf)]:
        road = Road((-1.75, 1.75), 3.5, ramp)
        assert value("on_access_ramp", AHEAD, road=road) == on_ramp
        assert value("on_main_carriageway", AHEAD, road=road) == on_main


def test_scales_are_units(value):
    fine = {"scales": {"longitudinal": 1.0, "speed": 1.0}}
    assert value("in_front_of", AHEAD, options=fine) == near(20.0)
    assert value("drives_faster", {"speed": 15.0}, options=fine) == near(5.0)


def test_lanes_by_role(value):
    road, shoulder = Road((-1.75, 1.75, 5.25, 8.75), 3.5, (3,)), {"shoulder": (0,)}
    for y, found in [(-1.75, "on_shoulder"), (1.75, "in_right_lane"), (5.25, "in_leftmost_lane")]:
        for name in ("on_shoulder", "in_right_lane", "in_leftmost_lane"):
            held = value(f"{name}(ego)", y=y, road=road, options=shoulder) > 0.0
            assert held == (name == found), (y, name)
    assert value("on_main_carriageway(ego)", y=-1.75, road=road, options=shoulder) < 0.0
    assert value("on_shoulder(ego)") == -np.inf


@pytest.mark.parametrize(("lanes", "broad"), [(1, False), (2, True), (3, True)])
def test_broad_roads(value, lanes, broad):
    road = Road(tuple(3.5 * k for k in range(lanes)), 3.5)
    assert value("on_broad_road(ego)", road=road) == (np.inf if broad else -np.inf)
    found = value("on_broad_road(ego)", road=road, options={"broad_road": 7.1})
    assert found == (np.inf if lanes > 2 else -np.inf)


def test_keeping_to_a_border_is_asked_of_every_lane_touched(value):
    # y 1.1: right side 0.1 m inside the lane [0, 3.5]
    assert value("keeps_right(ego)", y=1.1) == near(0.1 / 1.75)
    assert value("keeps_left(ego)", y=2.4) == near(0.1 / 1.75)
    # over the line by 0.5 m: right of its left lane, but far from the right border of the other
    assert value("keeps_right(ego)", y=4.0) == near(-0.5 / 1.75)
    assert value("keeps_left(ego)", y=4.0) == near(-1.5 / 1.75)


ONES, PAIRS = [("ego",), ("o",)], [("ego", "o"), ("o", "ego"), ("o", "p")]


@pytest.mark.parametrize("definitions", ["recommended", "published"])
@pytest.mark.parametrize("vehicles", [0, 1, 4])
def test_shapes_and_rows_bit_for_bit(lab, definitions, vehicles):
    rng = np.random.default_rng(vehicles)
    options = {"definitions": definitions, "lane_limit": (20.0, None, 30.0), "shoulder": (2,)}
    n = 23
    signals = lab.random(rng, n, vehicles)
    signals["others_speed"][::3] *= -1.0
    rows = [{field: array[i : i + 1] for field, array in signals.items()} for i in range(n)]
    for name, predicate in RECOMMENDED.predicates.items():
        for words in ONES if len(predicate.arguments) == 1 else PAIRS:
            bound = "".join(f"exists {word} in others: " for word in words if word != "ego")
            rule = lab.rule(None, vehicles, formula=f"{bound}{name}({', '.join(words)})", **options)
            ((key, together),) = rule.sample(signals).items()
            assert together.shape == (n,) + (vehicles,) * key.count("others"), key
            for i, row in enumerate(rows):
                assert np.array_equal(rule.sample(row)[key][0], together[i]), key


class TestBroadMarking:
    ROAD = Road((-1.75, 1.75, 5.25), 3.5, (0,), broad_markings=(1,))

    def both(self, lab, y):
        calls = ("right_of_broad_marking(ego)", "left_of_broad_marking(ego)")
        return [lab.value(call, road=self.ROAD, y=y)[0] for call in calls]

    def test_wholly_on_a_side(self, lab):
        assert self.both(lab, 1.75) == [pytest.approx(0.75 / 1.75), pytest.approx(-2.75 / 1.75)]
        assert self.both(lab, 5.25) == [pytest.approx(-2.75 / 1.75), pytest.approx(0.75 / 1.75)]
        assert max(self.both(lab, 3.4)) < 0.0  # upon it

    def test_a_road_without_one(self, lab):
        assert lab.value("right_of_broad_marking(ego)", y=1.75)[0] == -np.inf


class TestLanesThatEnd:
    MAIN = Lane(np.array([-100.0, 100.0]), np.full(2, 0.0), np.full(2, 3.5))
    RAMP = Lane(np.array([-100.0, 10.0]), np.full(2, -3.5), np.full(2, 0.0))
    ROAD = Road((-1.75, 1.75), 3.5, lanes=(RAMP, MAIN))

    def test_the_rightmost_lane_is_that_of_the_place(self, lab):
        beside, after = (lab.value("in_right_lane(ego)", road=self.ROAD, x=x)[0] for x in (0.0, 40.0))
        assert beside < 0.0 < after

    def test_the_road_is_as_broad_as_its_lanes_there(self, lab):
        beside, after = (lab.value("on_broad_road(ego)", road=self.ROAD, x=x)[0] for x in (0.0, 40.0))
        assert beside == np.inf
        assert after == -np.inf

    def test_nobody_is_in_a_lane_that_has_ended(self, lab):
        found = lab.value("in_same_lane(ego, {o})", {"x": 60.0, "y": -1.75}, road=self.ROAD, y=-1.75)
        assert found[0] < 0.0


def test_oncoming_traffic_is_not_left_traffic(lab):
    road = Road((1.75, 5.25), 3.5, opposing=(1,))
    oncoming = {"y": 5.25, "heading": np.pi, "speed": 10.0}
    rule = lab.rule("R_I2", road=road)
    assert not lab.judge(rule, oncoming)[0]
    assert lab.judge(rule, {**oncoming, "heading": 0.0})[0]


def test_the_distance_on_a_bent_road_is_that_of_the_plane(lab):
    road = Road((0.0,), 3.5, line=CurvedLine((Piece(200.0, 0.02, 0.02),)))
    found = lab.value("distance(ego, {o})", {"x": 40.0, "y": 20.0}, road=road, x=40.0, y=-10.0)
    assert found[0] == pytest.approx(30.0 - 2.0)
    one, other = (road.line.to_plane(np.array([x]), np.array([20.0])) for x in (0.0, 40.0))
    centres = np.hypot(*(np.array(other) - np.array(one)))[0]  # 24 m on the inner side of the bend
    found = lab.value("distance(ego, {o})", {"x": 40.0, "y": 20.0}, road=road, x=0.0, y=20.0)
    assert centres - 4.5 < found[0] < centres - 3.5
