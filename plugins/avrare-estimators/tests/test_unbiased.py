"""Splitting against exact answers: unbiased with ties, extinction, errors and any score; intervals cover."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.estimation.result.doubts import undo_opening
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import ReferenceProblem, count_down, reference_problem
from avrare.testing.walk_problems import Lag

WALK = reference_problem("d_rw_L2.5")
RARE_WALK = reference_problem("d_rw_L3.8")
COUNT_DOWN = reference_problem("f1_count_T40_q1o10_m12")
FEW_LEVELS = count_down(5, 9, "1/5")
PLUS_MINUS = reference_problem("f2_pm1walk_T60_q2o5_m14")
REACH = reference_problem("g_eventually_c0.5")
"""Its prefix robustness rises with time: levels on it would be wrong, and it brings a score of its own."""


def estimate(problem, seed=0, particles=50, discard=10, runs=200, **keywords):
    if isinstance(problem, ReferenceProblem):
        problem = problem.problem()
    return avrare.estimate(
        problem, "ams", seed=seed, particles=particles, discard=discard, runs=runs, **keywords
    )


def deviation(values, truth):
    """Return distance of the mean from the truth in standard errors."""
    return abs(values.mean() - truth) / (values.std(ddof=1) / np.sqrt(len(values)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "settings"),
    [
        (WALK, {"particles": 40, "discard": 4, "runs": 200}),
        (RARE_WALK, {"particles": 100, "discard": 50, "runs": 200}),
        (COUNT_DOWN, {"particles": 100, "discard": 10, "runs": 1000}),
        (FEW_LEVELS, {"particles": 10, "discard": 1, "runs": 4000}),
        (FEW_LEVELS, {"particles": 10, "discard": 8, "runs": 4000}),
        (PLUS_MINUS, {"particles": 100, "discard": 25, "runs": 300}),
        (REACH, {"particles": 100, "discard": 25, "runs": 300}),
    ],
)
def test_unbiased(problem, settings):
    values = estimate(problem, seed=17, **settings).run_probabilities
    assert deviation(values, problem.probability) < 4
    assert values.std(ddof=1) / np.sqrt(len(values)) < 0.12 * problem.probability, "too weak a test"


@pytest.mark.slow
def test_unbiased_over_two_hundred_seeds():
    values = np.array(
        [estimate(FEW_LEVELS, seed, particles=30, discard=5, runs=1).probability for seed in range(200)]
    )
    assert deviation(values, FEW_LEVELS.probability) < 4


@pytest.mark.slow
@pytest.mark.parametrize("score", [odd_systems.height, odd_systems.backwards, systems.constant, Lag(0.1)])
def test_any_score_is_unbiased(score):
    """Estimate with a bad score, which costs but does not lie; even one that discards the failures first."""
    task = avrare.Problem(systems.Walk(), avrare.stl("always (x < 0.4)"), 6, score)
    truth = avrare.estimate(task, seed=1, rollouts=200_000).probability
    assert 0.04 < truth < 0.2
    values = estimate(task, particles=20, discard=5, runs=1500).run_probabilities
    error = values.std(ddof=1) / np.sqrt(len(values)) + np.sqrt(truth / 200_000)
    assert abs(values.mean() - truth) < 4 * error


@pytest.fixture(scope="module")
def ties():
    """Return many small runs on a lattice: ties at every level, and many runs that die out."""
    return estimate(FEW_LEVELS, seed=3, particles=10, discard=2, runs=4000)


def test_ties_are_discarded_together_and_counted(ties):
    discarded = [count for counts in ties.diagnostics["discarded"] for count in counts]
    assert min(discarded) >= 2
    assert np.mean(np.array(discarded) > 2) > 0.5
    levels = ties.diagnostics["levels"]
    assert all((np.diff(run) > 0).all() for run in levels)
    assert ties.diagnostics["stages"] == [len(run) for run in levels]


def test_the_weight_of_the_nominal_count_would_be_detected(ties):
    """Show that weights by K, in place of the number discarded, would not pass."""
    values, truth = ties.run_probabilities, FEW_LEVELS.probability
    actual = np.array([np.prod([1 - k / 10 for k in run]) for run in ties.diagnostics["discarded"]])
    nominal = np.array([(1 - 2 / 10) ** len(run) for run in ties.diagnostics["discarded"]])
    assert deviation(values, truth) < 4
    assert deviation(values / actual * nominal, truth) > 20


def test_dropping_extinct_runs_would_be_detected(ties):
    values, truth = ties.run_probabilities, FEW_LEVELS.probability
    extinct = values == 0.0
    assert 0.1 < extinct.mean() < 0.9
    assert ties.diagnostics["extinct_runs"] == extinct.sum()
    assert deviation(values[~extinct], truth) > 10


@pytest.mark.slow
def test_genealogical_variance_is_unbiased():
    result = estimate(FEW_LEVELS, seed=5, particles=40, discard=5, runs=3000)
    truth = FEW_LEVELS.probability
    squares = (result.run_probabilities - truth) ** 2
    assert deviation(squares - np.array(result.diagnostics["genealogical_variance"]), 0.0) < 4
    assert squares.std() / np.sqrt(3000) < 0.1 * squares.mean()


@pytest.mark.slow
def test_interval_of_ten_runs_covers():
    truth, seeds = FEW_LEVELS.probability, 100
    results = [estimate(FEW_LEVELS, seed, particles=60, discard=10, runs=10) for seed in range(seeds)]
    intervals = [undo_opening(result).interval for result in results]
    covered = np.mean([low <= truth <= high for low, high in intervals])
    assert covered > 0.95 - 4 * np.sqrt(0.05 * 0.95 / seeds)
    assert np.median([high / low for low, high in intervals]) < 3


@pytest.mark.slow
@pytest.mark.parametrize("at_start", [False, True])
def test_random_errors(at_start):
    """Count rows that fail while no step breaks down. Breakdowns are rows like others, never redrawn."""
    steps, chance = 20, 0.01
    system = systems.Fragile.with_chance(0.2 if at_start else chance, at_start)
    survival = 0.8 if at_start else (1 - chance) ** steps
    task = avrare.Problem(system, avrare.stl("always (x < 1.2)"), steps)
    healthy = avrare.Problem(systems.Walk(), avrare.stl("always (x < 1.2)"), steps)
    p = avrare.estimate(healthy, seed=1, rollouts=300_000)
    truth = p.probability * survival
    result = estimate(task, seed=2, particles=40, discard=8, runs=900)
    values = result.run_probabilities
    error = values.std(ddof=1) / np.sqrt(len(values)) + truth * p.relative_error
    assert abs(values.mean() - truth) < 4 * error
    assert error < 0.05 * truth
    assert "errors" in result.health
    assert result.interval[1] > truth + 0.5 * (1 - survival)
