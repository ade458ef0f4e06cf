"""Confidence intervals and the few special functions they need, without importing SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

Interval = tuple[float, float]
_TINY = 1e-300
_WIDEST = 700.0
"""Where exp is still finite."""


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


def t_factor(confidence: float, freedom: float) -> float:
    """The t for which Student's t lies in [-t, t] with probability ``confidence``."""
    # P(|T| > t) = I_{f / (f + t^2)}(f / 2, 1 / 2)
    x = beta_quantile(1.0 - confidence, freedom / 2.0, 0.5)
    return math.sqrt(freedom * (1.0 - x) / x)


def normal_factor(confidence: float) -> float:
    """The z for which a standard normal lies in [-z, z] with probability ``confidence``."""
    return -NormalDist().inv_cdf((1.0 - confidence) / 2.0)


def unknown(confidence: float) -> Interval:
    """Where nothing was seen there is nothing to say."""
    return 0.0, 1.0


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


def inverse_binomial(failures: int, trials: int, confidence: float, undecided: int = 0) -> Interval:
    """Exact interval of rollouts that were stopped at a failure planned beforehand, the ``failures``-th.

    The lower bound is that of Clopper and Pearson; the upper one knows that the last rollout failed.
    """
    low, _ = clopper_pearson(failures, trials, confidence)
    if failures + undecided >= trials:
        return low, 1.0
    high = beta_quantile(0.5 + confidence / 2.0, failures + undecided, trials - failures - undecided)
    return low, high


def mixture(around: float) -> tuple[float, float]:
    """Beta(a, b) with mean ``around``, as broad as one failure: what the confidence sequence mixes over."""
    return 1.0, (1.0 - around) / around


def anytime(failures: int, trials: int, confidence: float, undecided: int = 0, *, around: float) -> Interval:
    """Interval that holds after every rollout at once (confidence sequence of a beta mixture, Robbins 1970).

    Args:
        failures: Rollouts that failed.
        trials: All rollouts.
        confidence: For example 0.95: of the whole sequence.
        undecided: Rollouts that ended in an error: the upper bound counts them as failures.
        around: Probability near which the sequence is tightest.
    """
    _, b = mixture(around)
    least = -math.log(1.0 - confidence)

    def mixed(failed: int) -> float:
        """Log of B(1 + failed, b + held) / B(1, b), whose log-gammas of a huge b would cancel to nothing."""
        begun = b + trials - failed
        return (
            math.lgamma(1 + failed) + math.log(b) - math.fsum(math.log(begun + i) for i in range(failed + 1))
        )

    def evidence(failed: int, p: float) -> float:
        """Log likelihood of the mixture over that of ``p``."""
        held = trials - failed
        log_p = (failed * math.log(p) if failed else 0.0) + (held * math.log1p(-p) if held else 0.0)
        return of_mixture[failed] - log_p

    low, high, worst = 0.0, 1.0, failures + undecided
    of_mixture = {failed: mixed(failed) for failed in {failures, worst}}
    if failures:
        low = _invert(lambda p: -evidence(failures, p) if p else -math.inf, -least, 0.0, failures / trials)
    if worst < trials:
        high = _invert(lambda p: evidence(worst, p) if p < 1.0 else math.inf, least, worst / trials, 1.0)
    return low, high


def log_normal(
    mean: float, relative_variance: float, confidence: float, *, freedom: int, undecided: float = 0.0
) -> Interval:
    """Interval mean * exp(+-factor * sqrt(log(1 + relative variance))) ("t delta-log", docs/statistics.md).

    Args:
        mean: Estimate, positive.
        relative_variance: Of the estimate.
        confidence: For example 0.95.
        freedom: Degrees of freedom of Student's t, runs - 1; 0: the variance is taken as known.
        undecided: Share of errors: the upper bound counts it as failures.
    """
    factor = t_factor(confidence, freedom) if freedom else normal_factor(confidence)
    width = min(factor * math.sqrt(math.log1p(relative_variance)), _WIDEST)
    return mean * math.exp(-width), min(1.0, mean * math.exp(width) + undecided)
