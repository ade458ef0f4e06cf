"""Splitting against exact answers: unbiased with ties, extinction, errors and any score; intervals cover."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import ReferenceProblem, count_down
from avrare.testing.repeated_estimates import deviation
from avrare.testing.walk_problems import Lag

FEW_LEVELS = count_down(5, 9, "1/5")


def estimate(problem, seed=0, particles=50, discard=10, runs=200, **keywords):
    if isinstance(problem, ReferenceProblem):
        problem = problem.problem()
    options = {"particles": particles, "discard": discard, "runs": runs, **keywords}
    return avrare.estimate(problem, "ams", seed=seed, **options)


@pytest.mark.slow
def test_unbiased_over_two_hundred_seeds():
    values = np.array(
        [estimate(FEW_LEVELS, seed, particles=30, discard=5, runs=1).probability for seed in range(200)]
    )
    assert abs(deviation(values, FEW_LEVELS.probability)) < 4


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


@pytest.mark.slow
def test_genealogical_variance_is_unbiased():
    result = estimate(FEW_LEVELS, seed=5, particles=40, discard=5, runs=3000)
    truth = FEW_LEVELS.probability
    squares = (result.run_probabilities - truth) ** 2
    assert abs(deviation(squares - np.array(result.diagnostics["genealogical_variance"]), 0.0)) < 4
    assert squares.std() / np.sqrt(3000) < 0.1 * squares.mean()


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
