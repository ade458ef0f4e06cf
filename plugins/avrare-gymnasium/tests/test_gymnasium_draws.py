"""Drawn attributes of environments: physics of its own for every rollout."""

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control import PendulumEnv

from avrare.base.errors import UsageError
from avrare.scenario.load import load
from avrare_gymnasium.config import GymnasiumConfig
from avrare_gymnasium.world import build

SCENARIO = """
name: heavy
steps: 10
simulator:
  plugin: gymnasium
  env: Pendulum-v1
  attributes: {m: {law: uniform, low: 0.5, high: 2.0}, g: 10.0}
  noise: {stream: {by: tape, at: reset, numbers: 2}}
controller: {plugin: gym_constant, action: [1.0]}
specifications: {slow: {stl: "always (o2 < 6)"}}
estimator: {plugin: mc, rollouts: 4}
"""


def drive(simulator, world, noise, steps=5):
    for _ in range(steps):
        world = simulator.step(world, np.ones((len(noise), 1)), np.zeros_like(noise))
    return simulator.signals(world)["o2"]


def test_every_rollout_has_its_own_and_the_fixed_one_agrees():
    options = {"env": "Pendulum-v1", "noise": {"stream": {"by": "tape", "at": "reset", "numbers": 2}}}
    simulator = build(GymnasiumConfig(**options)).drawing({"attributes.m": None})
    noise = np.zeros((3, simulator.noise_size))
    masses = np.array([0.5, 1.0, 2.0])
    found = drive(simulator, simulator.reset_drawn(noise, {"attributes.m": masses}), noise)
    assert len(set(found.tolist())) == 3
    for row, mass in enumerate(masses.tolist()):
        fixed = build(GymnasiumConfig(**options, attributes={"m": mass}))
        assert drive(fixed, fixed.reset(noise[:1]), noise[:1])[0] == found[row]


def test_a_scenario_draws_an_attribute(tmp_path):
    path = tmp_path / "heavy.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    scenario = load(path)
    assert scenario.simulator.draws.names == ("attributes.m",)
    assert scenario.simulator.config.attributes == {"m": 1.25, "g": 10.0}


def test_an_attribute_that_is_computed_is_refused():
    class Weighed(PendulumEnv):
        @property
        def weight(self):
            return self.m * self.g

    gymnasium.register("Weighed-v0", entry_point=Weighed)
    try:
        with pytest.raises(UsageError, match=r"attributes\.weight: Weighed computes it"):
            build(GymnasiumConfig(env="Weighed-v0", attributes={"weight": 1.0}))
    finally:
        del gymnasium.registry["Weighed-v0"]
