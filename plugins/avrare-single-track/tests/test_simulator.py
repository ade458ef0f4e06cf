"""The simulator as a whole: reset, step, signals, faults."""

import copy

import numpy as np
import pytest

from avrare.base.batch import concatenate, leaves, take
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


def test_reset_is_the_start_of_the_scenario_every_time(sim):
    world = start(sim, 3)
    assert {len(leaf) for leaf in leaves(world)} == {3}
    assert same(world, start(sim, 3))
    assert same(world, start(simulator(), 3))
    assert same(take(world, slice(0, 1)), start(sim, 1))
    assert (world.ego.speed == 20.0).all()
    assert (world.ego.acceleration == 0.0).all()
    assert (world.steering == 0.0).all()
    assert world.others.x[2].tolist() == [60.0, 30.0, 10.0]


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


def test_rows_are_independent_bit_for_bit(sim):
    rng = np.random.default_rng(2)
    n, noise = 11, np.zeros((11, 0))
    script = [actions(rng, n) for _ in range(12)]
    together, alone = start(sim, n), [start(sim, 1) for _ in range(n)]
    for asked in script:
        together = sim.step(together, asked, noise)
        for i in range(n):
            alone[i] = sim.step(alone[i], take(asked, slice(i, i + 1)), noise[:1])
    assert same(together, concatenate(alone))
    signals = sim.signals(together)
    for i in range(n):
        for name, values in sim.signals(alone[i]).items():
            assert np.array_equal(values[0], signals[name][i]), name


def test_taken_particles_continue_identically(sim):
    rng = np.random.default_rng(3)
    world = start(sim, 6)
    for _ in range(4):
        world = sim.step(world, actions(rng, 6), np.zeros((6, 0)))
    asked, chosen = actions(rng, 6), np.array([4, 4, 0])
    after = take(sim.step(world, asked, np.zeros((6, 0))), chosen)
    assert same(sim.step(take(world, chosen), take(asked, chosen), np.zeros((3, 0))), after)


def test_an_empty_road():
    sim = simulator([])
    world = start(sim, 2)
    for _ in range(3):
        world = sim.step(world, Action(np.zeros(2), np.zeros(2)), np.zeros((2, 0)))
    signals = sim.signals(world)
    assert signals["others_x"].shape == signals["distance"].shape == (2, 0)
    assert (signals["gap"] == np.inf).all()
    assert sim.scene.moving.dtype == bool
    assert not sim.faults(world).any()


@pytest.mark.parametrize("broken", [(np.nan, 0.0), (0.0, np.nan)])
def test_an_action_without_a_value_is_a_fault_of_its_row(sim, broken):
    asked = Action(np.array([0.0, broken[0]]), np.array([0.0, broken[1]]))
    world = sim.step(start(sim, 2), asked, np.zeros((2, 0)))
    assert sim.faults(world).tolist() == [False, True]


def test_without_a_controller_is_a_usage_error(sim):
    with pytest.raises(UsageError, match="needs a controller"):
        sim.step(start(sim, 1), None, np.zeros((1, 0)))
