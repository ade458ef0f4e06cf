"""The scenarios of this project that need no simulator of ours."""

from pathlib import Path

import pytest

import avrare
from avrare.cli.main import main
from avrare.scenario.fingerprint import named_files
from avrare_gymnasium.config import GymnasiumConfig

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
        ("simulator.env=CartPol-v1", 4, "there is no environment 'CartPol-v1'"),
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
