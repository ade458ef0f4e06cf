"""Scenes among drivers that react: they merge from a ramp that ends, and come towards the ego."""

from pathlib import Path

import numpy as np
import pytest

from avrare.rollout.loaded_scenario import load
from noise_free import noise_free

pytestmark = pytest.mark.slow
SCENARIOS = Path(__file__).parents[2] / "scenarios"


def drive(name):
    """Scene and signals of the rollout without noise."""
    scenario = load(SCENARIOS / f"{name}.yaml")
    return scenario.stack.scene, noise_free(scenario.problem("no_collision"))


def test_cars_merge_from_a_ramp_that_ends():
    scene, signals = drive("merging_traffic")
    assert scene.road.lanes[0].stations[-1] == 200.0
    y = {name: signals["others_y"][:, k] for k, name in enumerate(scene.names)}
    x = {name: signals["others_x"][:, k] for k, name in enumerate(scene.names)}
    assert y["second"][0] == -1.75
    assert abs(y["second"][-1] - 1.75) < 0.1
    assert x["entering"].max() + 2.2 < 200.0 or y["entering"][-1] > 0.0
    assert signals["gap"].min() > 1.0


def test_few_who_merge_make_others_brake_hard():
    scenario = load(SCENARIOS / "merging_traffic.yaml")
    loop = scenario.stack.loop
    rng = np.random.default_rng(5)
    state = loop.initial(rng.standard_normal((300, loop.noise_size)))
    hard = np.zeros(300, dtype=bool)
    for _ in range(scenario.steps):
        state = loop.step(state, rng.standard_normal((300, loop.noise_size)))
        hard |= (state.world.others.acceleration < -4.0).any(axis=1)
    assert 0 < hard.sum() <= 15


def test_the_ego_passes_before_what_comes_towards_it():
    scene, signals = drive("oncoming_traffic")
    tractor, oncoming = (signals["others_x"][:, scene.names.index(name)] for name in ("tractor", "oncoming"))
    assert (np.diff(oncoming) < -1.0).all()
    assert signals["ego_x"][-1] > tractor[-1] + 10.0
    assert signals["ego_y"].max() > 0.5
    assert abs(signals["ego_y"][-1] + 1.75) < 1.0
    assert signals["gap"].min() > 0.5
