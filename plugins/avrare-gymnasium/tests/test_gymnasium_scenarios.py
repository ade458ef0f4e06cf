"""Scenarios that need no simulator of ours; drawn attributes: physics of its own for every rollout."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control import PendulumEnv

import avrare
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare.scenario.fingerprint import named_files
from avrare.scenario.load import load
from avrare_gymnasium.config import GymnasiumConfig
from avrare_gymnasium.world import build

FOLDER = Path(__file__).parents[3] / "scenarios"
SPECIFICATION = {"cartpole": "upright", "pendulum": "upright", "lunar_lander": "upright"}


def scenario(name, *overrides):
    return avrare.load(FOLDER / f"{name}.yaml", overrides).problem(SPECIFICATION[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", SPECIFICATION)
def test_both_estimators_run(name):
    wild = {"pendulum": ["simulator.noise.action.scale=2.5"], "cartpole": ["simulator.noise.action.scale=2"]}
    problem = scenario(name, *wild.get(name, []), "chunk=20")
    brute = avrare.estimate(problem, "mc", rollouts=100)
    assert brute.errors == 0
    assert 0.0 < brute.probability < 0.6
    split = avrare.estimate(problem, "ams", particles=20, discard=5, runs=2)
    assert split.errors == 0
    assert 0.0 < split.probability < 1.0
    assert max(brute.interval[0], split.interval[0]) < min(brute.interval[1], split.interval[1])


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        ("simulator.env=CartPol-v1", 4, "unknown environment 'CartPol-v1'"),
        ("simulator.env=os:CartPole-v1", 4, "not an installed plugin"),
        ("simulator.copy=hook", 4, "snapshot, restore"),
        ("controller.gain=[[1, 2]]", 4, "the gain has 2 columns, but the observation has 4 numbers"),
    ],
)
def test_mistakes_are_one_clear_sentence(change, code, message, capsys):
    assert main(["validate", "--build", str(FOLDER / "cartpole.yaml"), "--set", change]) == code
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_files_that_the_environment_is_given_belong_to_the_scenario(tmp_path):
    body = tmp_path / "body.xml"
    body.write_text("one")
    config = GymnasiumConfig(env="Pendulum-v1", options={"xml_file": str(body), "mode": "fast", "gain": 2})
    assert dict(named_files(config)) == {"options.xml_file": body}


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
