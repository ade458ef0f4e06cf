"""``avrare synthesise`` and the scenarios that it writes."""

from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest
import yaml

import avrare
from avrare.cli.main import main
from avrare_linear.rewrite import ATTRIBUTES, has_parameter, rewrite_scenario
from avrare_linear.simulator import system_of
from avrare_linear.synthesis import DescentStep, descend

SCENARIOS = Path(__file__).parents[3] / "scenarios"
SQUARES = SCENARIOS / "four_squares.yaml"
QUICK = ["--chains", "20", "--runs", "2", "--moves", "5"]
LOOP = """
name: loop
steps: 4
simulator:
  plugin: linear
  states: [x, v]
  inputs: [a]
  outputs: [seen]
  A: [[1, 0.1], [0, 1]]
  B: [[0], [0.1]]
  C: [[1, 0]]
  process_noise: [0.01, 0.02]
  measurement_noise: [0.04]
  initial: {mean: [0, 1], covariance: [[0.02, 0.01], [0.01, 0.03]]}
  feedback: {state_cost: [1, 1], input_cost: [1]}
  observer: {}
  reference: [[0, 1], [0.1, 1]]
  feedforward: [0.5]
specifications:
  low: {stl: "always (x < 2)"}
  high: {stl: "always (x > -2)"}
estimator: {plugin: ess_linear}
"""


@pytest.fixture
def loop(tmp_path):
    path = tmp_path / "loop.yaml"
    path.write_text(LOOP)
    return path


@pytest.mark.slow
def test_the_four_squares_descend_to_the_origin(tmp_path, capsys):
    out = tmp_path / "better" / "scenario.yaml"
    arguments = ["synthesise", str(SQUARES), "--parameter", "mean", "--rate", "0.1", "--out", str(out.parent)]
    assert main([*arguments, *QUICK, "--chains", "40"]) == 0  # 20 end near 0.23 with every third seed
    text = capsys.readouterr().out
    assert "fresh estimates" in text
    mean = yaml.safe_load(out.read_text())["simulator"]["initial"]["mean"]
    assert np.abs(mean).max() < 0.2
    changed = avrare.load(out).problem("clear")
    found = avrare.estimate(changed, "ess_linear", seed=9)
    exact = (2.0 * NormalDist().cdf(-3.0)) ** 2
    assert 0.7 * exact < found.probability < 1.8 * exact


@pytest.mark.slow
def test_a_rate_is_found_where_none_is_given(tmp_path, capsys):
    assert main(["synthesise", str(SQUARES), "--parameter", "mean", "--steps", "2", *QUICK]) == 0
    lines = capsys.readouterr().out.splitlines()
    first, second = (float(line.split()[1]) for line in lines[1:3])
    assert second < 0.7 * first


@pytest.mark.parametrize("parameter", ATTRIBUTES)
def test_a_rewritten_scenario_has_the_new_value(parameter, loop, tmp_path):
    scenario = avrare.load(loop)
    system = system_of(scenario.problem("low"))
    assert has_parameter(system, parameter)
    value = 1.1 * getattr(system, ATTRIBUTES[parameter]) + 0.01
    path = tmp_path / "changed.yaml"
    path.write_text(yaml.safe_dump(rewrite_scenario(scenario.definition.resolved, parameter, value)))
    changed = system_of(avrare.load(path).problem("low"))
    for name in ATTRIBUTES.values():
        found = getattr(changed, name)
        given = value if name == ATTRIBUTES[parameter] else getattr(system, name)
        if name in ("spread", "process", "measurement"):
            found, given = (factor @ factor.swapaxes(1, 2) for factor in (found, given))
        np.testing.assert_allclose(found, given, rtol=1e-8, atol=1e-12)
    assert scenario.definition.resolved["simulator"]["initial"]["mean"] == [0.0, 1.0]


def test_a_kalman_gain_does_not_follow_the_noise_that_was_synthesised(loop, tmp_path):
    scenario = avrare.load(loop)
    system, resolved = system_of(scenario.problem("low")), scenario.definition.resolved
    changed = rewrite_scenario(resolved, "measurement_noise", 0.1 * system.measurement)
    np.testing.assert_allclose(changed["simulator"]["observer"]["gain"], system.observer, rtol=1e-8)
    same = rewrite_scenario(resolved, "mean", system.mean)
    assert same["simulator"]["observer"] == resolved["simulator"]["observer"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--parameter", "gain"], "the system has no gain\nhint: it has mean, covariance, "),
        (["--parameter", "observer"], "the system has no observer"),
        (["--parameter", "gian"], "a linear system has no parameter of this name"),
        (["--parameter", "mean", "--specification", "cleer"], "no specification 'cleer'"),
        (["--parameter", "mean", "--rate", "-1"], "positive, finite rate"),
        (["--parameter", "mean", "--rate", "inf"], "positive, finite rate"),
        (["--parameter", "mean", "--steps", "0"], "at least one iteration"),
        (["--parameter", "mean", "--out", "/dev/null"], "/dev/null: cannot write"),
        (["--parameter", "mean", "--chains", "1"], "at least 2 chains"),
        (["--parameter", "mean", "--runs", "0"], "1 run"),
        (["--parameter", "mean", "--moves", "-1"], "negative number of moves"),
    ],
)
def test_mistakes_are_reported(arguments, text, capsys):
    assert main(["synthesise", str(SQUARES), *QUICK, *arguments]) == 4
    told = capsys.readouterr()
    assert text in told.err
    assert told.out == ""


def test_a_descent_stops_where_a_step_is_not_worth_while():
    def bowl(value, iteration):
        return DescentStep(value, float(value[0] ** 2), 2.0 * value)

    seen, options = [], {"rate": 0.25, "iterations": 50, "least": 0.01}
    steps = descend(bowl, np.array([1.0]), **options, on_step=seen.append)
    assert steps == seen
    assert 0.25 * steps[-1].gradient[0] ** 2 < 0.01 <= 0.25 * steps[-2].gradient[0] ** 2


def test_the_first_step_without_a_rate_lowers_the_logarithm_by_one():
    def slope(value, iteration):
        return DescentStep(value, float(np.exp(3.0 * value[0])), np.array([3.0]))

    steps = descend(slope, np.array([0.0]), rate=None, iterations=2)
    assert steps[1].probability == pytest.approx(steps[0].probability / np.e)
