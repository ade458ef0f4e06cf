"""Every predicate where sign and value can be told by hand.

Units: 10 m along the road, 1.75 m across it, 5 m/s, 2 m/s^2, 0.1 rad.
"""

import numpy as np
import pytest

from avrare.driving import Road

AHEAD, ASIDE = {"x": 24.0}, {"y": 5.25}


@pytest.fixture
def value(lab):
    def value(predicate, *others, rule=None, **ego):
        rule = rule or lab.rule("R_G1", len(others))
        found = lab.value(rule, predicate, *others, **ego)
        return found if np.ndim(found) == 0 or found.size != 1 else float(found[0])

    return value


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


def test_cut_in_counts_only_into_a_lane_of_the_ego(value):
    assert value("cut_in", {"y": 3.5, "heading": -0.3}, y=-1.75) < 0.0
    assert value("cut_in", {"y": 0.0, "heading": 0.3}, y=-1.75) < 0.0  # o is to the left, turning left
    assert value("cut_in", {"y": 0.0, "heading": -0.3}, y=-1.75) > 0.0


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
    relative = value(
        "brakes_abruptly_relative", *({"acceleration": a} for a in (-2.0, 0.0, 2.0)), acceleration=-3.0
    )
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


def test_in_slow_traffic_needs_three_others_ahead(value):
    queue = [{"x": 10.0 * k, "y": 5.25, "speed": 10.0} for k in range(4)]
    found = value("in_slow_traffic", *queue)
    # ahead of the first: gaps of 6, 16, 26 m; 6.67 m/s below the limit; mid-lane 2.75 m
    np.testing.assert_allclose(found[0], 0.6, atol=1e-12)
    assert (found[1:] < 0.0).all()
    quick = [*queue[:3], {**queue[3], "speed": 20.0}]
    np.testing.assert_allclose(value("in_slow_traffic", *quick)[0], (16.67 - 20.0) / 5.0, atol=1e-12)
    elsewhere = [*queue[:3], {**queue[3], "y": -1.75}]
    assert value("in_slow_traffic", *elsewhere)[0] == near(-0.75 / 1.75)  # the middle lane is between them


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_too_few_vehicles_are_no_queue(value, count):
    found = np.atleast_1d(value("in_slow_traffic", *[{"x": 10.0 * k, "speed": 1.0} for k in range(count)]))
    assert found.shape == (count,)
    assert (found == -np.inf).all()  # a vehicle is not ahead of itself


def test_queue_size_is_an_option(lab, value):
    pair = [{"x": 10.0 * k, "speed": 10.0} for k in range(2)]
    rule = lab.rule("R_I2", 2, queue_size=1)
    np.testing.assert_allclose(value("in_slow_traffic", *pair, rule=rule), [0.6, -1.4], atol=1e-12)


def test_ramp_and_carriageway(value):
    assert value("on_access_ramp", AHEAD, y=-1.75) == near(2.75 / 1.75)
    assert value("on_access_ramp", AHEAD, y=1.75) == near(-0.75 / 1.75)
    assert value("on_access_ramp", AHEAD, y=0.9) == near(0.1 / 1.75)  # one side is on it
    assert value("on_main_carriageway", {"y": 1.75}) == near(2.75 / 1.75)
    assert value("on_main_carriageway", {"y": -1.75}) == near(-0.75 / 1.75)


def test_roads_without_a_ramp_or_nothing_but_a_ramp(lab, value):
    for ramp, on_ramp, on_main in [((), -np.inf, 2.75 / 1.75), ((0, 1), 2.75 / 1.75, -np.inf)]:
        rule = lab.rule("R_I2", road=Road((-1.75, 1.75), 3.5, ramp))
        assert value("on_access_ramp", AHEAD, rule=rule) == on_ramp
        assert value("on_main_carriageway", AHEAD, rule=rule) == on_main


def test_scales_are_units(lab, value):
    fine = lab.rule("R_G1", scales={"longitudinal": 1.0, "speed": 1.0})
    assert value("in_front_of", AHEAD, rule=fine) == near(20.0)
    assert value("drives_faster", {"speed": 15.0}, rule=fine) == near(5.0)


ALL = [
    "in_same_lane", "in_front_of", "cut_in", "keeps_safe_distance", "precedes", "brakes_abruptly",
    "brakes_abruptly_relative", "slow", "preserves_flow", "left_of", "drives_faster", "in_slow_traffic",
    "drives_slightly_faster", "on_access_ramp", "on_main_carriageway", "single_lane",
]  # fmt: skip
OF_THE_EGO = {"brakes_abruptly", "preserves_flow", "on_access_ramp", "brakes"}


@pytest.mark.parametrize("definitions", ["recommended", "published"])
@pytest.mark.parametrize("vehicles", [0, 1, 4])
def test_shapes_and_rows_bit_for_bit(lab, definitions, vehicles):
    from avrare_traffic_rules.traffic import read_traffic

    rng = np.random.default_rng(vehicles)
    rule = lab.rule("R_G1", vehicles, definitions=definitions)
    names = ALL + (["brakes"] if definitions == "published" else [])

    def values(signals, name):
        traffic = read_traffic(signals, rule.scene, rule._chosen, rule._predicates.extents)
        return getattr(rule._predicates, name)(traffic)

    n = 23
    signals = lab.random(rng, n, vehicles)
    for name in names:
        together = values(signals, name)
        assert together.shape == ((n,) if name in OF_THE_EGO else (n, vehicles)), name
        for i in range(n):
            row = {key: array[i : i + 1] for key, array in signals.items()}
            assert np.array_equal(values(row, name)[0], together[i]), name


@pytest.mark.parametrize("name", ALL)
def test_random_crowds_meet_both_signs(lab, name):
    rng = np.random.default_rng(7)
    from avrare_traffic_rules.traffic import read_traffic

    rule = lab.rule("R_G1", 8)
    traffic = read_traffic(lab.random(rng, 400, 8), rule.scene, rule._chosen, rule._predicates.extents)
    found = getattr(rule._predicates, name)(traffic)
    assert (found > 0.0).any()
    assert (found < 0.0).any()
