"""The simulator as a whole: reset, step, signals, faults."""

import copy

import numpy as np
import pytest

from avrare.base.batch import leaves
from avrare.base.errors import UsageError
from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

VEHICLES = [
    {"name": "parked", "x": 60.0, "y": 1.75},
    {"name": "moving", "x": 30.0, "y": 5.25, "speed": 15.0, "heading": 0.02},
    {
        "name": "driven",
        "x": 10.0,
        "y": -1.75,
        "speed": 10.0,
        "drive": {"lanes": [0], "steps": 10, "y_min": -3.0},
    },
]


def simulator(vehicles=VEHICLES):
    ego = {"x": 0.0, "y": 1.75, "speed": 20.0}
    road = {"access_ramp": [0]}
    options = {"ego": ego, "road": road, "vehicles": vehicles, "after_impact": "go_on"}
    return build(SingleTrackConfig.model_validate(options))


@pytest.fixture(scope="module")
def sim():
    return simulator()


def start(sim, n):
    return sim.reset(np.zeros((n, 0)))


def actions(rng, n):
    return Action(rng.normal(0.0, 4.0, n), rng.normal(0.0, 0.3, n))


def same(a, b):
    return all(np.array_equal(p, q, equal_nan=True) for p, q in zip(leaves(a), leaves(b), strict=True))


def test_scene(sim):
    assert sim.noise_size == 0
    assert sim.scene.names == ("parked", "moving", "driven")
    assert sim.scene.moving.tolist() == [False, True, True]
    assert sim.scene.road.access_ramp == (0,)
    assert sim.scene.dt == sim.dt == 0.1


def test_signals(sim):
    world = start(sim, 4)
    signals = sim.signals(world)
    fields = ("x", "y", "heading", "speed", "acceleration")
    levels = {f"{name}_acceleration" for name in ("longitudinal", "lateral", "combined")}
    levels |= {"jerk", "time_to_collision"}
    assert {f"ego_{name}" for name in fields} | {f"others_{name}" for name in fields} | levels | {
        "distance",
        "gap",
    } == (signals.keys())
    for name, values in signals.items():
        assert values.shape == ((4, 3) if name.startswith("others") or name == "distance" else (4,)), name
        assert values.dtype == np.float64
    assert signals["distance"][0, 0] == pytest.approx(60.0 - 4.298)
    assert np.array_equal(signals["gap"], signals["distance"].min(axis=1))
    ramp = np.hypot(10.0 - 4.298, 3.5 - 1.674)
    assert signals["gap"][0] == pytest.approx(ramp)


def test_a_step_moves_everyone_once(sim):
    rng = np.random.default_rng(1)
    world = start(sim, 5)
    for t in range(1, 15):
        before = copy.deepcopy(world)
        after = sim.step(world, actions(rng, 5), np.zeros((5, 0)))
        assert same(world, before)  # the old world is left alone
        assert (after.step == t).all()
        assert np.array_equal(after.ego.acceleration, (after.ego.speed - world.ego.speed) / 0.1)
        change = (after.others.speed - world.others.speed) / 0.1
        np.testing.assert_allclose(after.others.acceleration, change, atol=1e-9)
        np.testing.assert_allclose(after.others.x[:, 1], 30.0 + 1.5 * t * np.cos(0.02), atol=1e-12)
        world = after


@pytest.mark.parametrize("broken", [(np.nan, 0.0), (0.0, np.nan)])
def test_an_action_without_a_value_is_a_fault_of_its_row(sim, broken):
    asked = Action(np.array([0.0, broken[0]]), np.array([0.0, broken[1]]))
    world = sim.step(start(sim, 2), asked, np.zeros((2, 0)))
    assert sim.faults(world).tolist() == [False, True]


def test_without_a_controller_is_a_usage_error(sim):
    with pytest.raises(UsageError, match="needs a controller"):
        sim.step(start(sim, 1), None, np.zeros((1, 0)))
