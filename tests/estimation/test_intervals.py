"""Intervals against SciPy and against their own promises."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from avrare.estimation.result import intervals

CONFIDENCES = (0.5, 0.9, 0.95, 0.999, 1 - 1e-9)
TRIALS = (1, 2, 10, 1000, 1_000_000)
COUNTS = sorted({(k, n) for n in TRIALS for k in (0, 1, 2, n // 3, n // 2, n - 1, n) if 0 <= k <= n})


@pytest.mark.parametrize("confidence", CONFIDENCES)
@pytest.mark.parametrize(("k", "n"), COUNTS)
def test_clopper_pearson(k, n, confidence):
    low, high = intervals.clopper_pearson(k, n, confidence)
    tail = (1 - confidence) / 2
    assert low == pytest.approx(stats.beta.ppf(tail, k, n - k + 1) if k else 0.0, rel=1e-7)
    assert high == pytest.approx(stats.beta.isf(tail, k + 1, n - k) if k < n else 1.0, rel=1e-7)
    assert 0.0 <= low <= k / n <= high <= 1.0


def test_errors_raise_the_upper_bound_like_failures():
    for failures, errors in itertools.product((0, 3, 50), (1, 7, 50)):
        low, high = intervals.clopper_pearson(failures, 100, 0.95, errors)
        assert low == intervals.clopper_pearson(failures, 100, 0.95)[0]
        assert high > intervals.clopper_pearson(failures, 100, 0.95)[1] or high == 1.0
        assert high == intervals.clopper_pearson(failures + errors, 100, 0.95)[1]
    assert intervals.clopper_pearson(0, 100, 0.95, 100) == (0.0, 1.0)


def test_clopper_pearson_covers():
    """Sum the exact coverage, which is at least the confidence for every p."""
    n = 30
    bounds = [intervals.clopper_pearson(k, n, 0.9) for k in range(n + 1)]
    for p in np.linspace(0.001, 0.999, 200):
        covered = sum(stats.binom.pmf(k, n, p) for k, (low, high) in enumerate(bounds) if low <= p <= high)
        assert covered >= 0.9 - 1e-12


@pytest.mark.parametrize("freedom", [0, 1, 9])
@pytest.mark.parametrize("mean", [1e-18, 1e-6, 0.3, 1.0])
@pytest.mark.parametrize("relative_variance", [0.0, 1e-6, 0.5, 1.0, 30.0])
@pytest.mark.parametrize("confidence", [*CONFIDENCES, math.nextafter(1.0, 0.0)])
def test_log_normal_is_always_an_interval_around_the_mean(mean, relative_variance, confidence, freedom):
    low, high = intervals.log_normal(mean, relative_variance, confidence, freedom=freedom)
    assert 0.0 <= low <= mean <= high <= 1.0


def test_log_normal_by_hand():
    factor = stats.t.ppf(0.975, 9) * math.sqrt(math.log(1.04))
    expected = (1e-4 * math.exp(-factor), 1e-4 * math.exp(factor))
    assert intervals.log_normal(1e-4, 0.04, 0.95, freedom=9) == pytest.approx(expected, rel=1e-9)
    factor = 1.959963984540054 * math.sqrt(math.log(1.04))
    expected = (1e-4 * math.exp(-factor), 1e-4 * math.exp(factor) + 0.01)
    found = intervals.log_normal(1e-4, 0.04, 0.95, freedom=0, errors=0.01)
    assert found == pytest.approx(expected, rel=1e-9)


def test_cox_by_hand():
    values = [1e-4, 2e-4, 5e-4]
    logs = np.log(values)
    spread = logs.var(ddof=1)
    found = intervals.cox(values)
    assert found == pytest.approx((logs.mean() + spread / 2, spread / 3 + spread**2 / 4), rel=1e-12)
    assert intervals.cox([1e-4, 0.0, 2e-4]) is None
    assert intervals.cox([1e-4, 1e-4]) is None
    assert intervals.cox([1e-4]) is None


@pytest.mark.parametrize(
    "values", [[1e-4, 2e-4, 5e-4], [1e-4] * 9 + [1e-12], [1.0, 1e-9], [1e-300, 1.0, 0.9]]
)
@pytest.mark.parametrize("confidence", [1e-9, 0.5, 0.95, 1 - 1e-12])
def test_the_interval_of_runs_contains_their_mean_and_both_laws(values, confidence):
    mean, freedom = float(np.mean(values)), len(values) - 1
    relative = float(np.var(values, ddof=1)) / len(values) / mean**2
    logs = intervals.cox(values)
    low, high = intervals.log_normal(mean, relative, confidence, freedom=freedom, logs=logs)
    inner = intervals.log_normal(mean, relative, confidence, freedom=freedom)
    width = intervals.t_factor(confidence, freedom) * math.sqrt(logs[1])
    assert 0.0 <= low <= inner[0] <= mean <= inner[1] <= high <= 1.0
    assert low <= math.exp(min(logs[0] - width, 0.0)) * (1 + 1e-6)
    assert high >= math.exp(min(logs[0] + width, 0.0)) * (1 - 1e-6)


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_the_interval_of_log_normal_runs_covers(spread):
    rng, covered = np.random.default_rng(5), 0
    for _ in range(2000):
        values = rng.lognormal(-(spread**2) / 2, spread, 10) * 1e-3
        mean = float(values.mean())
        relative = float(values.var(ddof=1)) / 10 / mean**2
        low, high = intervals.log_normal(mean, relative, 0.95, freedom=9, logs=intervals.cox(values))
        covered += low <= 1e-3 <= high
    assert covered / 2000 >= 0.93  # with the spread of 1, the delta method alone covers 0.88
