"""Stopping by what is seen, without losing the confidence."""

from itertools import pairwise
from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.estimation.monte_carlo.monte_carlo import AtThreshold
from avrare.estimation.result.intervals import anytime
from avrare.testing.problems import linear


def coin(probability, chunk=4096):
    """Return a problem that fails with the given probability, at once."""
    return linear(-NormalDist().inv_cdf(probability), dim=1).problem(chunk=chunk)


def none(n):
    return np.zeros(n, dtype=bool)


@pytest.mark.parametrize("p", [0.002, 0.02, 0.3])
def test_the_true_probability_is_rarely_excluded_at_any_look(p):
    rule, rng = AtThreshold(p, confidence=0.9), np.random.default_rng(int(1e4 * p))
    wrong = [bool(rule.at(rng.random(6000) < p, none(6000))) for _ in range(500)]
    assert 0 < np.mean(wrong) < 0.1


@pytest.mark.parametrize(("p", "threshold"), [(0.01, 0.02), (0.04, 0.02), (0.0, 1e-3)])
def test_the_decision_is_on_the_right_side(p, threshold):
    rng = np.random.default_rng(7)
    rule = AtThreshold(threshold, confidence=0.95)
    right = 0
    for _ in range(200):
        failed = rng.random(30_000) < p
        stop = rule.at(failed, none(30_000))
        assert stop
        low, high = rule.interval(stop)(int(failed[:stop].sum()), stop, 0.95)
        right += high < threshold if p < threshold else low > threshold
    assert right >= 0.95 * 200 - 4 * np.sqrt(200 * 0.05)


def test_the_stop_is_the_first_interval_that_excludes_the_threshold():
    failed = np.random.default_rng(1).random(4000) < 0.004
    stop = AtThreshold(0.01, 0.95).at(failed, none(4000))
    bounds = [anytime(int(failed[:n].sum()), n, 0.95, around=0.01) for n in range(1, stop + 1)]
    inside = [low <= 0.01 <= high for low, high in bounds]
    assert inside == [True] * (stop - 1) + [False]


def test_without_failures_it_costs_little_more_than_one_planned_look():
    stop = AtThreshold(1e-3, 0.95).at(none(10_000), none(10_000))
    assert 3000 < stop < 5000  # a single planned look needs 2,995


def test_errors_delay_the_decision_as_possible_failures():
    broken = np.arange(6000) % 50 == 0
    assert AtThreshold(1e-2, 0.95).at(none(6000), broken) == 0
    assert AtThreshold(1e-1, 0.95).at(none(6000), broken) > 0
    low, high = anytime(0, 6000, 0.95, errors=120, around=1e-2)
    assert low == 0.0
    assert high > 0.02


def test_the_sequence_of_a_certain_failure():
    low, high = anytime(50, 50, 0.95, around=0.5)
    assert 0.8 < low < 1.0
    assert high == 1.0


@pytest.mark.slow
def test_monte_carlo_stops_there_whatever_the_chunks_and_workers():
    results = [
        avrare.estimate(coin(0.05, chunk), threshold=0.1, seed=3, workers=workers)
        for chunk, workers in ((64, 1), (64, 2), (1000, 1))
    ]
    kept = [{**r.to_dict(), "seconds": 0, "rollouts": 0, "simulated_steps": 0} for r in results]
    assert kept[0] == kept[1] == kept[2]
    assert results[0].interval[1] < 0.1
    assert results[0].diagnostics["used_rollouts"] <= results[0].rollouts < 1000


def test_a_threshold_at_the_probability_ends_at_the_maximum_of_rollouts():
    result = avrare.estimate(coin(0.5), threshold=0.5, rollouts=500, seed=1)
    assert result.rollouts == 500
    assert result.interval[0] < 0.5 < result.interval[1]


def test_two_ways_to_stop_are_refused():
    with pytest.raises(UsageError, match="choose one"):
        avrare.estimate(coin(0.5), threshold=0.5, relative_error=0.1)
    with pytest.raises(UsageError, match="leave runs at 1"):
        avrare.estimate(coin(0.5), threshold=0.5, runs=3)


@pytest.mark.parametrize("threshold", [1e-9, 1e-15, 1e-17, 1e-300])
def test_a_tiny_threshold_does_not_give_certainty(threshold):
    """Check a mixture all near 0: its interval is that of a flat likelihood, -log(0.05) / n."""
    low, high = anytime(0, 100_000, 0.95, around=threshold)
    assert low == 0.0
    assert high == pytest.approx(-np.log(0.05) / 100_000, rel=1e-3)
    low, high = anytime(3, 1000, 0.95, around=threshold)
    assert 0.1 * threshold < low < threshold
    assert 0.01 < high < 1.0


@pytest.mark.slow
def test_the_number_of_looks_is_limited():
    looks = []

    class Counting(AtThreshold):
        def at(self, violated, error):
            looks.append(len(violated))
            return super().at(violated, error)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("avrare.estimation.monte_carlo.monte_carlo.AtThreshold", Counting)
        result = avrare.estimate(coin(0.3, chunk=10), threshold=0.303, rollouts=60_000, seed=1)
    assert len(looks) < 120
    assert sum(looks) < 30 * result.rollouts
    assert all(after <= max(before + 64, before * 17 // 16) for before, after in pairwise(looks[:-1]))
