"""The simulator within a stack: scenarios, traffic rules, estimators, processes."""

from pathlib import Path

import highway_runs as runs
import numpy as np
import pytest
from highway_runs import run, simulator, tape

import avrare
from avrare.base.errors import ScenarioError
from avrare.stack.builder import build_rule

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
    from avrare_policy.network import Network, save

    weights = np.zeros((6 + 24, 2), dtype=np.float32)
    weights[6:12, 0] = 1.0 / 6.0
    save(
        tmp_path / "faster.npz",
        Network(
            (weights,), (np.zeros(2, dtype=np.float32),), "relu", np.zeros(30), np.ones(30),
            np.full(2, -1.0), np.full(2, 1.0), {},
        ),
    )  # fmt: skip
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
    problem = avrare.load(SCENARIOS / f"{name}.yaml", ["steps=4"])
    world = avrare.load(SCENARIOS / f"{name}.yaml")
    loop = world.stack.loop
    state = loop.initial(np.zeros((2, loop.noise_size)))
    for _ in range(3):
        state = loop.step(state, np.zeros((2, loop.noise_size)))
    assert (loop.signals(state)["x"] > 0.0).all()
    assert not loop.faults(state).any()
    assert problem.steps == 4
    assert runs.numbers(state.world)
