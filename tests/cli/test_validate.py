"""``avrare validate`` with the real plugins, and a simulator that breaks the rules."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from avrare.base import batch
from avrare.cli.main import main
from avrare_linear.simulator import LinearSimulator

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
PARKED = "simulator.vehicles=[{name: parked, x: 140.0, y: 1.75}]"


def test_the_scenarios_validate_without_warnings(capsys):
    for path in sorted(Path(LANE_CHANGE).parent.glob("*.yaml")):
        assert main(["validate", str(path)]) == 0
        assert capsys.readouterr().err == ""


RULE = "specifications={enter: {plugin: traffic_rules, rule: R_I5}, a: {plugin: traffic_rules, rule: R_G1}}"


@pytest.mark.parametrize(("steps", "doubts"), [(50, 0), (20, 1)])
def test_build_checks_the_horizon_of_a_plugins_rule(capsys, steps, doubts):
    words = ["validate", "--build", LANE_CHANGE, "--set", f"steps={steps}", "--set", PARKED, "--set", RULE]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert "built and run for 3 steps" in out
    assert err.count("warning: ") == doubts
    if doubts:
        assert err.startswith(f"warning: {LANE_CHANGE}: specifications.enter: the formula looks 50 samples ")
        assert "samples ahead but a rollout ends after 20: " in err


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("build", [[], ["--build"]])
def test_a_doubtful_formula_of_a_plugin_gives_one_warning(capsys, build):
    text = "always distance(ego, parked) > -9 and drives_faster(ego, parked) > -99"
    part = f"specifications={{odd: {{plugin: traffic_rules, formula: '{text}'}}}}"
    assert main(["validate", *build, LANE_CHANGE, "--set", PARKED, "--set", part]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{LANE_CHANGE}: ok")
    assert err.startswith("warning: --set specifications: ")
    assert (err.count("warning: "), err.count("binds tighter"), err.count("\nhint: ")) == (1, 1, 1)


def test_predicates_of_vehicles_in_a_plain_formula_hint_at_the_plugin(capsys):
    part = "specifications={far: {stl: 'forall o in others: always (distance(o, ego) > 2)'}}"
    assert main(["validate", "--build", LANE_CHANGE, "--set", PARKED, "--set", part]) == 4
    message, hint = capsys.readouterr().err.splitlines()
    assert message == f"{LANE_CHANGE}: specifications.far: signal 'distance(others, ego)' is missing"
    assert "{plugin: traffic_rules, formula: ...}" in hint


@pytest.mark.parametrize(
    ("part", "method", "given", "told"),
    [
        ("Driver", "act", (np.nan, None), "controller: its action is NaN at sample 0"),
        ("Simulator", "signals", {"offset": np.full(1, np.nan)}, "simulator: its signals (offset) are NaN"),
    ],
)
def test_build_names_the_part_that_gives_nan(drive, monkeypatch, capsys, part, method, given, told):
    path = drive()
    assert main(["validate", "--build", path]) == 0
    monkeypatch.setattr(getattr(sys.modules["avrare_gusts"], part), method, lambda *_: given)
    assert main(["validate", "--build", path]) == 5
    message, hint = capsys.readouterr().err.splitlines()
    assert message.startswith(f"drive.yaml: {told}")
    assert message.endswith("of a noise-free rollout")
    assert hint == "hint: rollouts with NaN in a signal (offset) are errors: mend this part"


LINE = """\
name: line
steps: 20
simulator:
  {plugin: linear, dt: 0.1, states: [x], A: [[1]], process_noise: [0.01],
   initial: {mean: [0], covariance: [0.01]}}
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
    path.write_text(LINE)
    return str(path)


@pytest.mark.parametrize("command", [["validate", "--build"], ["run", "--no-pictures", "--out", "out"]])
def test_splitting_refuses_it_with_the_reason(scenario, command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*command, scenario]) == 4
    out, err = capsys.readouterr()
    assert "a step changes the state or the noise that it is given (test_validate.py:" in err
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
