"""A scenario whose simulator breaks the rules: ``run`` and ``validate --build`` say so."""

import warnings

import pytest

from avrare.base import batch
from avrare.cli.main import main
from avrare_linear.simulator import LinearSimulator

SCENARIO = """\
name: line
steps: 20
simulator:
  plugin: linear
  dt: 0.1
  states: [x]
  A: [[1]]
  process_noise: [0.01]
  initial: {mean: [0], covariance: [0.01]}
specifications:
  low: {stl: "always (x < 0.5)"}
estimator: {plugin: ams, particles: 20, discard: 4, runs: 2}
"""


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    """Return a scenario of a simulator that changes its state in place."""
    step = LinearSimulator.step

    def in_place(self, world, action, noise):
        later = step(self, world, action, noise)
        batch.leaves(world)[0][...] = batch.leaves(later)[0]
        return later

    monkeypatch.setattr(LinearSimulator, "step", in_place)
    path = tmp_path / "line.yaml"
    path.write_text(SCENARIO)
    return str(path)


@pytest.mark.parametrize("command", [["validate", "--build"], ["run", "--no-pictures", "--out", "out"]])
def test_splitting_refuses_it_with_the_reason(scenario, command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*command, scenario]) == 4
    out, err = capsys.readouterr()
    assert "a step changes the state or the noise that it is given (test_rule_breakers.py:" in err
    assert err.count("hint: ") == 1
    assert "ok" not in out


def test_monte_carlo_takes_it(scenario, capsys, tmp_path):
    mc = ["--set", "estimator={plugin: mc, rollouts: 50}"]
    assert main(["validate", "--build", scenario, *mc]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arguments = ["--quiet", "--no-pictures", "--out", str(tmp_path / "out")]
        low = 'specifications.low.stl="eventually (x > 9)"'
        assert main(["run", scenario, *mc, *arguments, "--set", low]) == 0
    out, err = capsys.readouterr()
    assert out.endswith("all_failed\n")
    assert err == ""
