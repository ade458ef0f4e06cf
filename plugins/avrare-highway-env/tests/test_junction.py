"""Rules of intersections on highway-env's crossing: areas and verdicts by hand, and runs.

In these coordinates the ego comes from the south at x = 2 m, cars from the west at y = -2 m, from the east at
y = 2 m. Lanes are 4 m wide, cars 5 m long, and ways through the crossing begin 11 m before its middle. The
ego's way begins 111 m before it: its conflict area with the straight way from the west is the stretch of 107
to 111 m, of which the other's stations are 11 to 15 m.
"""

from pathlib import Path

import numpy as np
import pytest
from highway_runs import simulator, tape

import avrare
from avrare.base.errors import UsageError
from avrare.stack.builder import build_rule
from avrare_highway_env.junction import TURNS, _find_way

WEST, NORTH, EAST = 4, 8, 12  # numbers of ways are these and 3 to the right, 2 straight on, 1 to the left
STEPS = 81
SCENARIO = Path(__file__).parents[3] / "scenarios" / "intersection.yaml"


@pytest.fixture(scope="module")
def straight():
    return simulator(scene="intersection", dt=0.1, vehicles=2).junction


def along(x, y, heading, speed, acceleration=0.0):
    """Return states (T, 5) on a straight line from a place."""
    t = 0.1 * np.arange(STEPS)
    v = np.maximum(speed + acceleration * t, 0.0)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.1)])
    change = np.where(v > 0.0, acceleration, 0.0)
    rows = x + way * np.cos(heading), y + way * np.sin(heading), np.full(STEPS, heading), v, change
    return np.stack(rows, axis=1)


def judge(scene, rule, ego, others):
    """Return whether a rule is violated by an ego among others, of whom each has a number of its way."""
    rule = build_rule(rule, [], scene)
    state, fields = rule.start(1), ("x", "y", "heading", "speed", "acceleration")
    absent = np.tile([1e6, 1e6, 0.0, 0.0, 0.0], (STEPS, 1))
    cars = [car for car, _ in others] + [absent] * (len(scene.names) - len(others))
    ways = np.array([[way for _, way in others] + [-1.0] * (len(scene.names) - len(others))])
    for t in range(STEPS):
        signals = {f"ego_{name}": ego[t : t + 1, k] for k, name in enumerate(fields)}
        for k, name in enumerate(fields):
            signals[f"others_{name}"] = np.array([[car[t, k] for car in cars]])
        state, verdict = rule.update(state, {**signals, "others_way": ways})
    return bool(verdict.violated[0])


EGO = along(2.0, -30.0, 0.5 * np.pi, 10.0)
"""Its front is in the area of y = -4 to 0 from 2.35 s on, its rear until 3.25 s."""


@pytest.mark.parametrize(
    ("rule", "car", "way", "violated"),
    [
        # in x = 0 to 4 from 3.0 s to 3.9 s
        ("R_IN4", along(-32.5, -2.0, 0.0, 10.0), WEST + 2, True),
        # from 4.3 s on, 1.05 s after the ego has left; 0.85 s after
        ("R_IN4", along(-45.5, -2.0, 0.0, 10.0), WEST + 2, False),
        ("R_IN4", along(-43.5, -2.0, 0.0, 10.0), WEST + 2, True),
        # leaves x = 4 with its rear at 1.8 s, 0.55 s before the ego enters; at 2.0 s, 0.35 s before
        ("R_IN4", along(-11.5, -2.0, 0.0, 10.0), WEST + 2, False),
        ("R_IN4", along(-13.5, -2.0, 0.0, 10.0), WEST + 2, True),
        # it stands: its front is 6.5 m before the area
        ("R_IN4", along(-9.0, -2.0, 0.0, 0.0), WEST + 2, False),
        # it brakes with 2 m/s^2 while the ego is in the area, 9.5 to 5.6 m before it, and never reaches it
        ("R_IN4", along(-30.0, -2.0, 0.0, 10.0, -2.0), WEST + 2, True),
        # the other road has priority, and right before left is out of force
        ("R_IN3", along(-32.5, -2.0, 0.0, 10.0), WEST + 2, False),
        # oncoming traffic matters to who turns left alone
        ("R_IN5", along(-2.0, 30.0, -0.5 * np.pi, 10.0), NORTH + 2, False),
        # from the east: y = 0 to 4 is entered by the ego from 2.75 to 3.65 s, by the other from 2.75 s on
        ("R_IN4", along(34.0, 2.0, np.pi, 10.0), EAST + 2, True),
        # the same, but its way is not known: it has none of the ways that meet the ego's
        ("R_IN4", along(34.0, 2.0, np.pi, 10.0), -1, False),
    ],
)
def test_right_of_way(straight, rule, car, way, violated):
    assert judge(straight, rule, EGO, [(car, way)]) == violated


def test_areas_of_the_ego_that_goes_straight_on(straight):
    areas = {one.way: one for one in straight.road.crossings}
    assert {one.reason for one in areas.values()} == {"sign"}
    one, other = areas[WEST + 2], areas[EAST + 2]
    found = (one.begin, one.end, one.line_begin, one.line_end, one.half_width)
    assert found == pytest.approx((107.0, 111.0, 11.0, 15.0, 2.0), abs=0.3)
    found = (other.begin, other.end, other.line_begin, other.line_end)
    assert found == pytest.approx((111.0, 115.0, 7.0, 11.0), abs=0.3)
    assert WEST + 3 not in areas  # who turns right from the west goes south


def test_an_ego_that_turns_left_minds_those_who_come_towards_it():
    left = simulator(scene="intersection", dt=0.1, vehicles=2, way="left").junction
    reasons = {one.way: one.reason for one in left.road.crossings}
    assert reasons[NORTH + 2] == reasons[NORTH + 3] == "oncoming"
    assert NORTH + 1 not in reasons
    assert reasons[EAST + 2] == "sign"
    place = along(2.0, -30.0, 0.5 * np.pi, 10.0)[:20]  # to the crossing, then along its arc of 13 m
    angle = np.arange(STEPS - len(place)) / 13.0 * 0.8
    arc = np.stack([-11.0 + 13.0 * np.cos(angle), -11.0 + 13.0 * np.sin(angle), angle + 0.5 * np.pi], axis=1)
    tail = np.concatenate([arc, np.full((len(arc), 1), 8.0), np.zeros((len(arc), 1))], axis=1)
    ego = np.concatenate([place, tail])
    assert judge(left, "R_IN5", ego, [(along(-2.0, 25.0, -0.5 * np.pi, 8.0), NORTH + 2)])
    assert not judge(left, "R_IN5", ego, [(along(-2.0, 200.0, -0.5 * np.pi, 8.0), NORTH + 2)])


def test_rules_of_lanes_are_refused(straight):
    with pytest.raises(UsageError, match=r"reads .*, and this simulator has no lanes"):
        build_rule("R_G1", [], straight)
    assert build_rule("no_collision", [], straight).names


def test_vehicles_keep_their_slots_and_ways():
    sim = simulator(scene="intersection", vehicles=4, dt=0.5, substeps=5)
    noise = tape(sim, 2, 24, seed=3)
    world = sim.reset(noise[:, 0])
    seen = 0
    for t in range(1, noise.shape[1]):
        before, world = world, sim.step(world, np.zeros((2, 2)), noise[:, t])
        both = (before.others.x < 1e5) & (world.others.x < 1e5)
        moved = np.hypot(world.others.x - before.others.x, world.others.y - before.others.y)
        same = both & (moved < 20.0)  # a slot may be given to another car, which comes from afar
        assert (moved[same] < 12.0).all()
        np.testing.assert_array_equal(world.ways[same], before.ways[same])
        seen += int((same & (world.ways >= 0)).sum())
    assert seen > 20
    assert sim.signals(world)["others_way"].shape == world.others.x.shape


def test_vehicles_drive_along_the_ways_that_they_are_said_to_take():
    sim = simulator(scene="intersection", vehicles=6, dt=0.5, substeps=5)
    network, turns = sim.environment.road.network, {quarters: turn for turn, quarters in TURNS.items()}
    noise = tape(sim, 4, 24, seed=5)
    world, seen = sim.reset(noise[:, 0]), set()
    for t in range(1, noise.shape[1]):
        world = sim.step(world, np.zeros((4, 2)), noise[:, t])
        others = world.others
        for row, slot in np.argwhere((np.hypot(others.x, others.y) < 9.0) & (world.ways >= 0)):
            corner, quarters = divmod(int(world.ways[row, slot]), 4)
            place = others.x[row, [slot]], others.y[row, [slot]]
            _, aside = _find_way(network, corner, turns[quarters]).line.to_road(*place)
            assert abs(aside[0]) < 1.0
            seen.add(turns[quarters])
    assert seen > {"left"} or seen > {"right"}


def test_a_probability_of_breaking_a_rule():
    problem = avrare.load(SCENARIO, ["steps=45", "simulator.vehicles=3", "chunk=4"]).problem("priority")
    found = avrare.estimate(problem, "mc", rollouts=4, seed=1)
    assert found.errors == 0
    assert 0.0 <= found.interval[0] <= found.probability <= found.interval[1] <= 1.0
