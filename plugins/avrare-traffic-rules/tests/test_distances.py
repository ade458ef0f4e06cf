"""Distances, times and braking as predicates, told by hand; units as in test_predicates."""

import numpy as np
import pytest

from avrare.driving import Road

AHEAD = {"x": 24.0}


def near(expected):
    return pytest.approx(expected, abs=1e-12)


def test_raw_quantities_have_units(value):
    other = {"x": 24.0, "speed": 15.0, "acceleration": -1.0, "heading": 0.1}
    assert value("speed(ego)") == 20.0
    assert value("speed(a)", other) == 15.0
    assert value("acceleration(a)", other) == -1.0
    assert value("heading(a)", other) == 0.1
    assert value("gap(ego, a)", AHEAD) == near(20.0)
    assert value("gap(a, ego)", AHEAD) == near(-28.0)
    assert value("distance(ego, a)", {"x": 7.0, "y": 7.75}) == near(5.0)


@pytest.mark.parametrize(
    ("other", "seconds"),
    [
        ({"x": 24.0, "speed": 10.0}, 2.0),
        ({"x": 24.0, "speed": 20.0}, np.inf),
        ({"x": 24.0, "speed": 30.0}, np.inf),
        ({"x": -24.0, "speed": 30.0}, 2.0),  # who closes in from behind
        ({"x": 24.0, "speed": 10.0, "y": 5.25}, np.inf),
        ({"x": 3.0}, 0.0),  # they overlap
        ({"x": 4.0}, 0.0),  # they touch, closing or not
        ({"x": 4.0, "speed": 30.0}, 0.0),
        ({"y": 3.75}, 0.0),
        ({"x": 4.0 + 1e-9}, np.inf),
        # crosses from the left: the ego is there between 37 / 20 and 43 / 20 s, the other's front after 2 m
        ({"y": 6.75, "speed": 1.0, "heading": -np.pi / 2, "x": 40.0}, 2.0),
        ({"y": 6.75, "speed": 0.9, "heading": -np.pi / 2, "x": 40.0}, np.inf),
    ],
)
def test_time_to_collision(value, other, seconds):
    assert value("time_to_collision(ego, a)", other) == near(seconds)
    assert value("time_to_collision(a, ego)", other) == near(seconds)


def test_time_to_collision_is_when_moving_rectangles_first_touch(value):
    rng = np.random.default_rng(3)
    times = np.arange(0.0, 6.0, 0.002)
    met = 0
    for _ in range(60):
        other = {"x": rng.uniform(-30, 30), "y": rng.uniform(-8, 8), "speed": rng.uniform(0, 30)}
        other["heading"] = rng.normal(0.0, 0.4)
        cos, sin = abs(np.cos(other["heading"])), abs(np.sin(other["heading"]))
        x = other["x"] + (other["speed"] * np.cos(other["heading"]) - 20.0) * times
        y = other["y"] + other["speed"] * np.sin(other["heading"]) * times - 1.75
        reach_x, reach_y = 2.0 + 2.0 * cos + sin, 1.0 + 2.0 * sin + cos
        touching = (np.abs(x) < reach_x) & (np.abs(y) < reach_y)
        found = value("time_to_collision(ego, a)", other)
        if touching.any():
            met += 1
            assert found == pytest.approx(times[touching.argmax()], abs=0.0021)
        else:
            assert found > 5.99
    assert 10 < met < 50


def test_rss_longitudinal(value):
    # 20 + 3.5/2 + 23.5^2/8 - v^2/16
    needed = 20.0 + 1.75 + 23.5**2 / 8.0 - 100.0 / 16.0
    assert value("rss_longitudinal(ego, a)", {"x": 24.0, "speed": 10.0}) == near(20.0 - needed)
    assert value("rss_longitudinal(ego, a)", {"x": 24.0, "speed": 60.0}) == near(20.0)  # none is needed


@pytest.mark.parametrize("onward", [{"speed": 10.0}, {"speed": -10.0, "heading": np.pi}])
@pytest.mark.parametrize("against", [{"speed": -10.0}, {"speed": 10.0, "heading": np.pi}, {"speed": 0.0}])
def test_a_vehicle_against_the_road_has_no_braking_distance(value, onward, against):
    room = {"x": 24.0}  # 20 m
    safe = 20.0 - 20.0**2 / 20.0 - 0.4 * 20.0
    assert value("keeps_safe_distance", {**room, **onward}) == near((safe + 10.0**2 / 21.0) / 10.0)
    assert value("keeps_safe_distance", {**room, **against}) == near(safe / 10.0)
    rss = 20.0 - (20.0 + 1.75 + 23.5**2 / 8.0)
    for call, scale in [("rss_longitudinal(ego, a)", 1.0), ("keeps_rss_longitudinal(ego, a)", 10.0)]:
        assert value(call, {**room, **onward}) == near((rss + 10.0**2 / 16.0) / scale)
        assert value(call, {**room, "speed": 0.0}) == near(rss / scale)
    # the ego that moves away from what is ahead needs nothing, or what it gains in the response time
    assert value("keeps_safe_distance", {**room, "speed": 0.0}, **against) == near(2.0)
    gained = 1.75 + 3.5**2 / 8.0
    assert value("rss_longitudinal(ego, a)", {**room, "speed": 0.0}, **against) == near(20.0 - gained)


def stopping_way(speed, braking):
    return speed + 1.75 + (speed + 3.5) ** 2 / (2.0 * braking)


@pytest.mark.parametrize(
    ("lane", "ego", "other"),
    [
        (1.75, 3.0, 4.0),  # in a lane of the ego's direction
        (5.25, 4.0, 3.0),  # in one of the other direction
        (3.5, 4.0, 4.0),  # the ego is in the latter and in the former, and so is the other vehicle
    ],
)
def test_oncoming_traffic_needs_the_ways_of_both(lab, lane, ego, other):
    """Definition 3 of the paper: who is in a lane of its direction need not brake as hard."""
    road = Road((-1.75, 1.75, 5.25), 3.5, opposing=(2,))
    needed = stopping_way(20.0, ego) + stopping_way(15.0, other)
    for oncoming in ({"speed": 15.0, "heading": np.pi}, {"speed": -15.0}):
        found = lab.value("rss_longitudinal(ego, a)", {"x": 204.0, "y": lane, **oncoming}, road=road, y=lane)
        assert found == near(200.0 - needed)
    options = {"rss_least_braking_correct": 4.0}
    oncoming, place = {"x": 204.0, "y": lane, "speed": -15.0}, {"road": road, "y": lane}
    both = lab.value("rss_longitudinal(ego, a)", oncoming, options=options, **place)
    assert both == near(200.0 - stopping_way(20.0, 4.0) - stopping_way(15.0, 4.0))


def test_rss_lateral(value):
    aside = {"y": 5.25}
    assert value("rss_lateral(ego, a)", aside) == near(1.5 - 0.1 - 0.25)
    assert value("rss_lateral(a, ego)", aside) == near(1.5 - 0.1 - 0.25)
    # moves away by more than it can turn back in the response time: nothing is needed, the margin is
    margin = 5.25 - 1.75 - 1.0 - 2.0 * np.sin(0.05) - np.cos(0.05) - 0.1
    assert value("rss_lateral(ego, a)", {**aside, "speed": 30.0, "heading": 0.05}) == near(margin)
