"""Confidence intervals and the few special functions they need, without importing SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist, fmean

Interval = tuple[float, float]
_TINY = 1e-300


def beta_cdf(x: float, a: float, b: float) -> float:
    """Regularised incomplete beta function I_x(a, b), by Lentz' continued fraction (NR 6.4)."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    if x < (a + 1.0) / (a + b + 2.0):
        return math.exp(log_front) * _continued_fraction(x, a, b) / a
    return 1.0 - math.exp(log_front) * _continued_fraction(1.0 - x, b, a) / b


def _continued_fraction(x: float, a: float, b: float) -> float:
    def nonzero(value: float) -> float:
        return value if abs(value) > _TINY else _TINY

    c, d = 1.0, 1.0 / nonzero(1.0 - (a + b) * x / (a + 1.0))
    result = d
    for m in range(1, 100_000):
        for coefficient in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1.0 / nonzero(1.0 + coefficient * d)
            c = nonzero(1.0 + coefficient / c)
            result *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return result


def _invert(cdf: Callable[[float], float], target: float, low: float, high: float) -> float:
    """The point where an increasing function reaches ``target``, by bisection to the last bit."""
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        if cdf(middle) < target:
            low = middle
        else:
            high = middle


def beta_quantile(q: float, a: float, b: float) -> float:
    """The q-quantile of Beta(a, b)."""
    return _invert(lambda x: beta_cdf(x, a, b), q, 0.0, 1.0)


def t_quantile(q: float, freedom: float) -> float:
    """The q-quantile of Student's t, for q >= 0.5."""
    # P(T > t) = I_{f / (f + t^2)}(f / 2, 1 / 2) / 2
    x = beta_quantile(2.0 * (1.0 - q), freedom / 2.0, 0.5)
    return math.sqrt(freedom * (1.0 - x) / x)


def normal_quantile(q: float) -> float:
    """The q-quantile of the standard normal."""
    return NormalDist().inv_cdf(q)


def clopper_pearson(failures: int, trials: int, confidence: float, undecided: int = 0) -> Interval:
    """Exact binomial interval; one-sided at 0 or ``trials`` failures.

    Args:
        failures: Rollouts that failed.
        trials: All rollouts.
        confidence: For example 0.95.
        undecided: Rollouts that ended in an error: the upper bound counts them as failures.
    """
    tail = 1.0 - confidence
    lower_tail = tail if failures == trials else tail / 2.0
    worst = failures + undecided
    upper_tail = tail if worst == 0 else tail / 2.0
    low = 0.0 if failures == 0 else beta_quantile(lower_tail, failures, trials - failures + 1)
    high = 1.0 if worst == trials else beta_quantile(1.0 - upper_tail, worst + 1, trials - worst)
    return low, high


def log_normal(mean: float, relative_variance: float, factor: float) -> Interval:
    """Interval mean * exp(+-factor * sqrt(log(1 + relative variance))), clipped to [0, 1]."""
    width = factor * math.sqrt(math.log1p(relative_variance))
    return mean * math.exp(-width), min(1.0, mean * math.exp(width))


def of_runs(values: list[float], confidence: float) -> Interval:
    """Interval of the mean of independent runs, "t delta-log" (docs/statistics.md).

    Args:
        values: Two or more run probabilities, not all zero.
        confidence: For example 0.95.
    """
    mean, count = fmean(values), len(values)
    variance = sum((value - mean) ** 2 for value in values) / (count - 1) / count
    return log_normal(mean, variance / mean**2, t_quantile(0.5 + confidence / 2.0, count - 1))
