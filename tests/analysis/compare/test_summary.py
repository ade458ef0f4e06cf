"""Statistics of repetitions, on numbers that can be checked by hand."""

import math

import numpy as np
import pytest

from avrare.analysis.compare.case import GroundTruth
from avrare.analysis.compare.repetition_statistics import find_disagreements, summarise
from avrare.estimation.result import intervals
from plain_results import plain_result

P = 1e-3


def repetition(value, interval=None, rollouts=100, health=(), relative_error=math.nan, steps=None):
    return plain_result(
        probability=value,
        interval=interval or (value / 2, value * 2),
        relative_error=relative_error,
        rollouts=rollouts,
        simulated_steps=10 * rollouts if steps is None else steps,
        health=dict.fromkeys(health, ""),
    )


def summary(*repetitions, truth=P, steps=10):
    return summarise(repetitions, GroundTruth(truth, "given") if truth else None, steps, 0.95)


def test_the_numbers_by_hand():
    found = summary(repetition(0.5e-3), repetition(2e-3, rollouts=300, health=("few_roots",)))
    accuracy = found.accuracy
    assert found.mean == pytest.approx(1.25e-3)
    assert (found.steps, found.rollouts, found.simulations) == (2000, 200, 200)
    assert (found.warned, found.warnings, found.zeros) == (1, {"few_roots": 1}, 0)
    assert accuracy.ratio == pytest.approx(1.25)
    assert accuracy.relative_rmse == pytest.approx(math.sqrt((0.25 + 1.0) / 2))
    assert accuracy.work == pytest.approx(0.625 * 200)
    assert accuracy.speed_up == pytest.approx(999 / 125)
    assert accuracy.covered == 2
    assert accuracy.covered_interval == intervals.clopper_pearson(2, 2, 0.95)


def test_coverage_counts_both_ends():
    spans = [(P, 1.0), (0.0, P), (2 * P, 1.0), (0.0, P / 2)]
    found = summary(*(repetition(P * (1 + i), span) for i, span in enumerate(spans)))
    assert found.accuracy.covered == 2


def test_columns_are_empty_without_truth_or_spread():
    alone = summary(repetition(P))
    assert (alone.mean, alone.interval, alone.accuracy) == (P, None, None)
    assert summary(repetition(P), repetition(2 * P), truth=None).accuracy is None
    assert summarise([], None, 10, 0.95) is None


def test_estimates_that_saw_nothing_are_not_fast():
    found = summary(*[repetition(0.0, (0.0, 0.03), rollouts=1)] * 5)
    assert found.interval == (0.0, 1.0)
    assert (found.zeros, found.accuracy.covered) == (5, 5)
    assert found.accuracy.missed
    assert found.accuracy.speed_up is None
    assert found.accuracy.speed_up_interval is None


def test_a_small_error_around_the_wrong_value_is_not_fast():
    values = P * np.array([0.09, 0.10, 0.11, 0.10, 0.12])
    found = summary(*map(repetition, values.tolist()))
    assert found.accuracy.missed
    assert found.accuracy.speed_up is None
    right = summary(*map(repetition, (10 * values).tolist()))
    assert not right.accuracy.missed
    assert right.accuracy.speed_up > 100


def test_equal_estimates_do_not_give_certainty():
    found = summary(*[repetition(P, relative_error=0.5)] * 4)
    low, high = found.interval
    assert low < 0.7 * P
    assert high > 1.4 * P
    assert found.accuracy.speed_up is None, "no error at all: the speed-up has no value"


def test_the_interval_of_the_work_covers():
    rng, hits, trials = np.random.default_rng(1), 0, 200
    for _ in range(trials):
        values = P * (1.0 + 0.2 * rng.standard_normal(10))
        low, high = summary(*map(repetition, values.tolist())).accuracy.work_interval
        hits += low <= 0.04 * 100 <= high
    assert hits / trials > 0.85, "docs/compare.md says 0.9 for normal errors and ten repetitions"


def test_estimators_whose_means_cannot_both_be_right_disagree():
    low = summary(*(repetition(value) for value in (1.0e-3, 1.1e-3, 0.9e-3)))
    high = summary(*(repetition(value) for value in (9.0e-3, 9.1e-3, 8.9e-3)))
    wide = summary(*(repetition(value) for value in (1.0e-3, 30.0e-3, 4.0e-3)))
    assert find_disagreements(["a", "b", "c", "d"], [low, high, wide, None]) == [("a", "b")]
