"""Cross-entropy: it finds its way to failure, is unbiased, and says when it has not arrived."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.testing.problems import reference_problem

sys.path.insert(0, str(Path(__file__).parent))
import toy_closed_loop as toy


def estimate(problem, seed=0, **options):
    return avrare.estimate(problem, "ce", seed=seed, **{"rollouts": 500, **options})


def deviation(values, truth):
    values = np.asarray(values)
    return abs(values.mean() - truth) / (values.std(ddof=1) / np.sqrt(len(values)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("d_rw_L2.5", {"runs": 25}),
        ("b_linear_d100_p1e-4", {"runs": 40, "rollouts": 1000}),
        ("a_beta_-2", {"runs": 60, "family": {"name": "gaussian", "components": 2}}),
        ("c_fourbranch_k7", {"runs": 60}),
    ],
)
def test_unbiased(name, options):
    problem = reference_problem(name)
    result = estimate(problem.problem(), check=0.0, **options)
    assert deviation(result.run_probabilities, problem.probability) < 4
    assert result.relative_error < 0.15
    low, high = result.interval_at(0.9999)
    assert low <= problem.probability <= high


def test_levels_rise_until_failure_is_reached():
    problem = reference_problem("b_linear_d100_p1e-6")
    result = estimate(problem.problem(), rollouts=1000)
    stages = result.diagnostics["stages"][0]
    levels = [stage["level"] for stage in stages]
    assert levels == sorted(levels)
    assert [stage["reached"] for stage in stages[-2:]] == [True, True]
    assert stages[0]["failures"] < stages[-1]["failures"]
    assert 0.2 < result.probability / problem.probability < 5


def test_the_estimate_uses_a_sample_that_no_stage_has_seen():
    problem = reference_problem("a_beta_-2")
    result = estimate(problem.problem(), check=0.0)
    used = len(result.diagnostics["stages"][0])
    assert result.rollouts == 500 * (used + 1)
    assert result.diagnostics["rows"] == [500]


def test_not_reaching_failure_gives_a_warning():
    problem = reference_problem("b_linear_d100_p1e-9")
    result = estimate(problem.problem(), rollouts=200, stages=2)
    assert len(result.diagnostics["stages"][0]) == 2
    assert "unchecked" in result.health
    low, high = result.interval
    assert low <= problem.probability <= high
    assert high > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ["e_ou_L5.0", "e_ou_L6.0"])
def test_many_design_points_do_not_fail_silently(name):
    """Warn: one Gaussian cannot stand for failures that may come at any time."""
    problem = reference_problem(name)
    for seed in range(4):
        result = estimate(problem.problem(), seed, rollouts=1000)
        low, high = result.interval
        assert result.health or low / 3 <= problem.probability <= high * 3


@pytest.mark.slow
def test_same_bits_for_two_workers():
    task = avrare.Problem(toy.Coin(), avrare.stl("always (x < 6)"), 9, chunk=40)
    one, two = (avrare.estimate(task, "ce", rollouts=200, runs=2, workers=w) for w in (1, 2))
    assert one.to_dict() | {"seconds": 0} == two.to_dict() | {"seconds": 0}
    np.testing.assert_array_equal(one.failures.noise, two.failures.noise)
    again = avrare.estimate(task, "ce", rollouts=200, runs=3)
    np.testing.assert_array_equal(again.run_probabilities[:2], one.run_probabilities)


def test_failures_replay():
    problem = reference_problem("d_rw_L3.8")
    result = estimate(problem.problem(), rollouts=800)
    assert len(result.failures.robustness) == 100
    again = problem.problem().robustness(result.failures.noise)
    np.testing.assert_array_equal(again, result.failures.robustness)


def test_the_budget_covers_complete_stages():
    problem = reference_problem("a_beta_-2").problem()
    result = avrare.estimate(problem, "ce", stages=4, runs=2, budget="rollouts=2000", check=0.0)
    assert result.diagnostics["rows"] == [200, 200]
    assert result.rollouts <= 2000
    with pytest.raises(avrare.UsageError, match="does not pay"):
        avrare.estimate(problem, "ce", stages=4, budget="rollouts=50")
    with pytest.raises(avrare.UsageError, match="clock"):
        avrare.estimate(problem, "ce", budget="seconds=5")


def test_the_sample_that_counts_takes_what_learning_leaves_of_a_budget():
    problem = reference_problem("a_beta_-2").problem()
    result = avrare.estimate(problem, "ce", budget="rollouts=11000", check=0.0)
    stages = len(result.diagnostics["stages"][0])
    assert stages < 10
    assert result.diagnostics["rows"] == [1000 * (11 - stages)]
    assert result.rollouts == 11_000


def test_diagnostics_are_json():
    entry = json.loads(estimate(reference_problem("a_beta_-2").problem()).to_json())
    assert {"stages", "second_look", "mean_weight", "effective_failures"} <= set(entry["diagnostics"])
    assert entry["diagnostics"]["stages"][0][0]["reached"] in (True, False)


def test_a_row_that_breaks_down_is_never_elite():
    task = avrare.Problem(toy.Coin(breaks=2.5), avrare.stl("always (x < 6)"), 9)
    result = estimate(task)
    assert result.errors > 0
    assert np.isfinite(result.probability)
    assert result.interval[1] <= 1.0


def test_a_problem_that_always_fails():
    task = avrare.Problem(toy.Coin(), avrare.stl("always (x < -1)"), 3)
    result = estimate(task, rollouts=50)
    assert result.probability == pytest.approx(1.0, abs=0.3)
    assert "all_failed" in result.health


@pytest.mark.parametrize(
    "wrong",
    [
        {"elite": 0.0},
        {"family": {"name": "gaussian", "components": 0}},
        {"family": {"name": "network", "components": 2}},
        {"family": "forest"},
        {"elit": 0.1},
    ],
)
def test_misuse(wrong):
    with pytest.raises(avrare.UsageError):
        estimate(reference_problem("a_beta_-2").problem(), **wrong)
