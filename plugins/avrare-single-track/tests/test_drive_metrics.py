"""Accelerations, jerk and time to collision; the friction circle of the plant."""

import numpy as np
import pytest

from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.drive_metrics import GRAVITY, lateral_acceleration, steering_angle
from avrare_single_track.simulator import build
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rule import build as build_rule

DT = 0.1


def simulator(vehicles=(), **ego):
    ego = {"x": 0.0, "y": 1.75, "speed": 20.0, **ego}
    return build(SingleTrackConfig.model_validate({"ego": ego, "vehicles": list(vehicles)}))


def drive(sim, actions):
    """Return the signals (N, T) of one action after another, each (acceleration, yaw_rate) of shape (N,)."""
    world = sim.reset(np.zeros((len(actions[0][0]), 0)))
    worlds = [world]
    for acceleration, yaw_rate in actions:
        world = sim.step(world, Action(np.asarray(acceleration), np.asarray(yaw_rate)), np.zeros((1, 0)))
        worlds.append(world)
    rows = [sim.signals(world) for world in worlds]
    return {name: np.stack([row[name] for row in rows], axis=1) for name in rows[0]}, worlds


def random_actions(n=200, steps=25, seed=3):
    rng = np.random.default_rng(seed)
    return [(rng.normal(0.0, 8.0, n), rng.normal(0.0, 0.6, n)) for _ in range(steps)]


def test_a_held_turn_has_the_acceleration_of_its_circle():
    sim = simulator(speed=15.0)
    signals, _ = drive(sim, [(np.zeros(1), np.full(1, 0.2))] * 20)
    assert signals["lateral_acceleration"][0, -1] == pytest.approx(15.0 * 0.2, rel=1e-12)
    heading = signals["ego_heading"][0]
    assert (heading[-1] - heading[-2]) / DT == pytest.approx(0.2, rel=1e-9)
    assert signals["lateral_acceleration"][0, 0] == 0.0
    right, _ = drive(sim, [(np.zeros(1), np.full(1, -0.2))] * 20)
    np.testing.assert_allclose(right["lateral_acceleration"], -signals["lateral_acceleration"], rtol=1e-12)


def test_the_angle_is_the_inverse_of_the_turn():
    delta = np.linspace(-0.8, 0.8, 33)
    ratio = lateral_acceleration(np.ones(33), delta, 1.0)
    np.testing.assert_allclose(steering_angle(ratio), delta, atol=1e-12)


def test_levels_belong_together():
    signals, _ = drive(simulator(), random_actions())
    along, across = signals["longitudinal_acceleration"], signals["lateral_acceleration"]
    np.testing.assert_array_equal(along, signals["ego_acceleration"])
    np.testing.assert_allclose(along[:, 1:], np.diff(signals["ego_speed"], axis=1) / DT, atol=1e-9)
    np.testing.assert_array_equal(signals["combined_acceleration"], np.hypot(along, across))
    change = np.hypot(np.diff(along, axis=1), np.diff(across, axis=1)) / DT
    np.testing.assert_allclose(signals["jerk"][:, 1:], change, rtol=1e-12)
    assert (signals["jerk"][:, 0] == 0.0).all()


def near(sim):
    return float(sim.signals(sim.reset(np.zeros((1, 0))))["time_to_collision"][0])


@pytest.mark.parametrize(
    ("vehicle", "seconds"),
    [
        ({"x": 64.298, "y": 1.75}, 3.0),  # 60 m between the bumpers at 20 m/s
        ({"x": 64.298, "y": 1.75, "speed": 5.0}, 4.0),
        ({"x": 64.298, "y": 1.75, "speed": 20.0}, np.inf),
        ({"x": 64.298, "y": 1.75, "speed": 30.0}, np.inf),
        ({"x": -30.0, "y": 1.75, "speed": 30.0}, np.inf),  # it is behind
        ({"x": 64.298, "y": 5.25}, np.inf),  # beside the way
        ({"x": 64.298, "y": 5.25, "heading": -0.5 * np.pi, "speed": 0.1}, np.inf),  # crosses too late
        ({"x": 3.0, "y": 2.0}, 0.0),  # touched
    ],
)
def test_time_to_collision_by_hand(vehicle, seconds):
    assert near(simulator([{"name": "a", **vehicle}])) == pytest.approx(seconds)


def test_the_nearest_in_time_counts_and_an_empty_road_has_none():
    far, slow = {"name": "far", "x": 64.298}, {"name": "slow", "x": 44.298, "speed": 15.0}
    assert near(simulator([far | {"y": 1.75}, slow | {"y": 1.75}])) == pytest.approx(3.0)
    assert near(simulator()) == np.inf


def test_time_to_collision_is_that_of_the_traffic_rules():
    rng = np.random.default_rng(8)
    for _ in range(50):
        vehicle = {"x": rng.uniform(0.5, 60), "y": rng.uniform(-2, 6), "speed": rng.uniform(0, 30),
                   "heading": rng.uniform(-0.4, 0.4), "name": "a"}  # fmt: skip
        sim = simulator([vehicle], speed=rng.uniform(0, 30), heading=rng.uniform(-0.4, 0.4))
        formula = "forall o in others: always (time_to_collision(ego, o) > 0)"
        rule = build_rule(TrafficRuleConfig(formula=formula), sim.scene)
        signals = sim.signals(sim.reset(np.zeros((1, 0))))
        _, verdict = rule.update(rule.start(1), signals)
        assert verdict.robustness[0] == pytest.approx(signals["time_to_collision"][0])


@pytest.mark.parametrize("friction", [0.3, 0.8, 1.0])
def test_the_friction_circle_holds_and_what_is_beyond_is_counted(friction):
    sim = simulator(friction=friction)
    signals, worlds = drive(sim, random_actions())
    combined, limit = signals["combined_acceleration"], friction * GRAVITY
    assert combined.max() == pytest.approx(limit, rel=1e-9)
    slips = sim.counts(worlds[-1])["friction_saturations"]
    at_the_limit = (combined > limit * (1.0 - 1e-9)).sum(axis=1)
    np.testing.assert_array_equal(slips, at_the_limit)
    assert (signals["ego_speed"] >= 0.0).all()


def test_demands_within_the_circle_are_met_to_the_same_bits():
    rng = np.random.default_rng(1)
    gentle = [(rng.normal(0.0, 1.0, 50), rng.normal(0.0, 0.02, 50)) for _ in range(20)]
    bound, free = simulator(friction=1.0), simulator()
    one, worlds = drive(bound, gentle)
    other, _ = drive(free, gentle)
    assert bound.counts(worlds[-1])["friction_saturations"].sum() == 0
    assert free.counts(worlds[-1]) == {}
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name])
