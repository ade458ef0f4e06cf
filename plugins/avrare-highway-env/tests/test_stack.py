"""The simulator within a stack: scenarios, traffic rules, estimators, processes."""

from pathlib import Path

import numpy as np
import pytest
from highway_runs import run, simulator, tape

import avrare
from avrare.base.errors import ScenarioError
from avrare.stack.builder import build_rule
from avrare_policy.network import Network, save

SCENARIOS = Path(__file__).parents[3] / "scenarios"
WORLD = """
name: world
steps: 20
simulator: {plugin: highway_env, %s}
controller: {plugin: policy, model: %s}
specifications:
  rule: %s
estimator: {plugin: mc, rollouts: 10}
chunk: 3
"""


@pytest.fixture
def policy(tmp_path):
    """Return a policy that only ever speeds up, the more the farther its first rays reach."""
    weights, two = np.zeros((6 + 24, 2), dtype=np.float32), np.ones(2)
    weights[6:12, 0] = 1.0 / 6.0
    layers = (weights,), (np.zeros(2, dtype=np.float32),)
    save(tmp_path / "faster.npz", Network(*layers, "relu", np.zeros(30), np.ones(30), -two, two, {}))
    return tmp_path / "faster.npz"


def scenario(tmp_path, policy, world, rule):
    path = tmp_path / "world.yaml"
    path.write_text(WORLD % (world, policy, rule))
    return avrare.load(path)


def test_traffic_rules_agree_with_highway_env():
    """Give full throttle on the merge, which ends in a collision: there the rule breaks."""
    sim = simulator(scene="merge")
    noise = tape(sim, 8, 90)
    worlds = run(sim, noise, lambda t, n: np.tile([1.0, 0.0], (n, 1)))
    collision, distance = (build_rule(name, [], sim.scene) for name in ("no_collision", "R_G1"))
    a, b = collision.start(8), distance.start(8)
    for world in worlds:
        a, crash = collision.update(a, sim.signals(world))
        b, near = distance.update(b, sim.signals(world))
    assert worlds[-1].crashed.any()
    assert np.array_equal(crash.violated, worlds[-1].crashed)
    assert (crash.robustness[worlds[-1].crashed] < -1e-3).all()
    assert near.violated[worlds[-1].crashed].all()


def test_rules_for_straight_roads_are_refused_on_other_roads(tmp_path, policy):
    world = scenario(tmp_path, policy, "scene: roundabout", "{plugin: traffic_rules, rule: R_G1}")
    with pytest.raises(ScenarioError, match="this simulator has no lanes"):
        world.problem("rule")


@pytest.mark.parametrize("name", ["merge_lidar", "highway"])
def test_the_scenarios_run(name):
    loop = avrare.load(SCENARIOS / f"{name}.yaml").stack.loop
    state = loop.initial(np.zeros((2, loop.noise_size)))
    for _ in range(3):
        state = loop.step(state, np.zeros((2, loop.noise_size)))
    assert (loop.signals(state)["x"] > 0.0).all()
    assert not loop.faults(state).any()
