"""Confidence intervals of a probability, of a difference and of a ratio.

Where there were errors, the upper bound of a probability counts them as failures. The intervals of a
difference and of a ratio of two independent estimates come from theirs (MOVER: Zou and Donner 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import variance

from avrare.base.special_functions import beta_quantile, bisect, normal_factor, t_factor
from avrare.protocols import Floats

Interval = tuple[float, float]


def unknown(confidence: float) -> Interval:
    """Return [0, 1]: no failure was observed, so nothing is known."""
    return 0.0, 1.0


def clopper_pearson(failures: int, trials: int, confidence: float, errors: int = 0) -> Interval:
    """Return the exact binomial interval (Clopper and Pearson 1934), two-sided at every count."""
    # One side at 0 failures alone would be chosen after the fact: coverage .9385 at 95 %.
    tail, worst = (1.0 - confidence) / 2.0, failures + errors
    low = 0.0 if failures == 0 else beta_quantile(tail, failures, trials - failures + 1)
    high = 1.0 if worst == trials else beta_quantile(1.0 - tail, worst + 1, trials - worst)
    return low, high


def inverse_binomial(failures: int, trials: int, confidence: float, errors: int = 0) -> Interval:
    """Return the exact interval of inverse sampling, stopped at a number of failures fixed beforehand.

    The lower bound is that of Clopper and Pearson; the upper one uses that the last rollout failed.
    """
    low, _ = clopper_pearson(failures, trials, confidence)
    if failures + errors >= trials:
        return low, 1.0
    high = beta_quantile(0.5 + confidence / 2.0, failures + errors, trials - failures - errors)
    return low, high


def mixture(around: float) -> tuple[float, float]:
    """Return a and b of the Beta law that ``anytime`` mixes over: mean ``around``, width of one failure."""
    return 1.0, (1.0 - around) / around


def anytime(failures: int, trials: int, confidence: float, errors: int = 0, *, around: float) -> Interval:
    """Return an interval valid after all rollouts at once, tightest for probabilities near ``around``.

    It is a beta-mixture confidence sequence (Robbins 1970).
    """
    _, b = mixture(around)
    threshold = -math.log(1.0 - confidence)

    def log_mixture(failed: int) -> float:
        # log B(1 + failed, b + held) / B(1, b): a difference of log-gammas would cancel for a huge b
        begun = b + trials - failed
        return (
            math.lgamma(1 + failed) + math.log(b) - math.fsum(math.log(begun + i) for i in range(failed + 1))
        )

    def evidence(failed: int, p: float) -> float:
        # log of the likelihood of the mixture over that of p
        passed = trials - failed
        log_p = (failed * math.log(p) if failed else 0.0) + (passed * math.log1p(-p) if passed else 0.0)
        return of_mixture[failed] - log_p

    low, high, worst = 0.0, 1.0, failures + errors
    of_mixture = {failed: log_mixture(failed) for failed in {failures, worst}}
    if failures:
        low = bisect(lambda p: -evidence(failures, p) if p else -math.inf, -threshold, 0.0, failures / trials)
    if worst < trials:
        high = bisect(lambda p: evidence(worst, p) if p < 1.0 else math.inf, threshold, worst / trials, 1.0)
    return low, high


def cox(values: Sequence[float] | Floats) -> tuple[float, float] | None:
    """Return the logarithm of a log-normal mean and its variance by Cox's method (Olsson 2005).

    None where a value is 0, all are equal, or there is only one.
    """
    if len(values) < 2 or min(values) <= 0.0:
        return None
    logs = [math.log(value) for value in values]
    spread = variance(logs)
    if not spread:
        return None
    runs = len(logs)
    return math.fsum(logs) / runs + spread / 2.0, spread / runs + spread**2 / (2.0 * (runs - 1))


def log_normal(
    mean: float,
    relative_variance: float,
    confidence: float,
    *,
    freedom: int,
    errors: float = 0.0,
    logs: tuple[float, float] | None = None,
) -> Interval:
    """Return mean * exp(+-factor * sqrt(log(1 + relative variance))) ("t delta-log", docs/statistics.md).

    ``freedom`` is that of Student's t, runs - 1; 0: the variance counts as known. ``errors`` is a share.
    With ``logs``, the result of ``cox``, each end is the farther one of this interval and Cox's.
    """
    factor = t_factor(confidence, freedom) if freedom else normal_factor(confidence)
    laws = log_normal_laws(mean, relative_variance, logs)
    low = min(centre - factor * math.sqrt(spread) for centre, spread in laws)
    high = max(centre + factor * math.sqrt(spread) for centre, spread in laws)
    return min(math.exp(low), mean), min(1.0, max(math.exp(min(high, 0.0)), mean) + errors)


def scaled_counts(mean: float, failures: int, trials: int, confidence: float) -> Interval:
    """Return the exact binomial interval of a count, in proportion to an estimate that rests on it."""
    low, high = clopper_pearson(failures, trials, confidence)
    return mean * low * trials / failures, min(1.0, mean * high * trials / failures)


def hull(
    first: Callable[[float], Interval], second: Callable[[float], Interval], confidence: float
) -> Interval:
    """Return the least interval that holds two others."""
    (low, high), (lower, higher) = first(confidence), second(confidence)
    return min(low, lower), max(high, higher)


def log_normal_laws(
    mean: float, relative_variance: float, logs: tuple[float, float] | None
) -> list[tuple[float, float]]:
    """Return centre and variance of the logarithm in each of the laws that ``log_normal`` joins."""
    return [(math.log(mean), math.log1p(relative_variance)), *([logs] if logs else [])]


def weighted_counts(
    weights: Floats, trials: int, largest: float, confidence: float, errors: Floats | None = None
) -> Interval:
    """Return the interval of a probability estimated by a sum of weights of the failures that were found.

    Each of ``trials`` tapes is one of a few sorts of failure, found with a probability r of its sort and then
    weighted by 1 / (trials r), or nothing. The law of the sum is matched by a scaled binomial one, with one
    more failure of the largest weight at the upper end (Fay and Feuer, Statistics in Medicine 16, 1997, with
    beta in place of gamma quantiles). With equal weights it is Clopper and Pearson's.

    Args:
        weights: Of the failures found.
        trials: Tapes of the first phase.
        largest: Largest weight that a failure may have.
        confidence: Level.
        errors: Weights of tapes that broke down; they count as failures in the upper end.
    """
    sums = math.fsum(weights), math.fsum(weights**2)
    broken = (0.0, 0.0) if errors is None else (math.fsum(errors), math.fsum(errors**2))
    return matched_counts(sums, trials, largest, confidence, broken)


def matched_counts(
    sums: tuple[float, float],
    trials: int,
    largest: float,
    confidence: float,
    broken: tuple[float, float] = (0.0, 0.0),
) -> Interval:
    """Return the interval of ``weighted_counts`` from the sums of the weights and of their squares.

    Args:
        sums: Both sums, over the failures.
        trials: Rollouts.
        largest: Largest weight that a failure may have.
        confidence: Level.
        broken: Both sums, over rollouts that broke down.
    """
    tail, (total, squares) = (1.0 - confidence) / 2.0, sums
    low = 0.0
    if total > 0.0:
        share, size = _match_moments(total, squares, trials)
        low = (
            beta_quantile(tail, share * size, size - share * size + 1.0)
            if share < 1.0
            else tail ** (1 / size)
        )
    total, squares = total + broken[0] + largest, squares + broken[1] + largest**2
    share, size = _match_moments(total, squares, trials)
    high = beta_quantile(1.0 - tail, share * size, size - share * size + 1.0) if share < 1.0 else 1.0
    return low, high


def _match_moments(total: float, squares: float, trials: int) -> tuple[float, float]:
    """Return share and size of the binomial law with the mean and the variance of a weighted sum."""
    if total >= 1.0:
        return 1.0, float(trials)
    variance = max(squares - total**2 / trials, 1e-300)
    return total, total * (1.0 - total) / variance


Estimate = tuple[float, float, float]
"""Value, lower and upper end of the interval."""


def subtract_estimates(minuend: Estimate, subtrahend: Estimate) -> tuple[float, float]:
    """Return the interval of the first minus the second."""
    (value, low, high), (less, least, most) = minuend, subtrahend
    change = value - less
    return change - math.hypot(value - low, most - less), change + math.hypot(high - value, less - least)


def divide_estimates(numerator: Estimate, denominator: Estimate) -> tuple[float, float]:
    """Return the interval of the first over the second, on the logarithm; it may reach 0 and infinity."""
    (value, low, high), (divisor, least, most) = numerator, denominator
    if not (value and divisor):
        return low / most if most else 0.0, high / least if least else math.inf
    ratio = value / divisor
    below = math.hypot(_log_ratio(value, low), _log_ratio(most, divisor))
    above = math.hypot(_log_ratio(high, value), _log_ratio(divisor, least))
    return ratio * math.exp(-below), ratio * math.exp(above) if above < 700.0 else math.inf


def _log_ratio(high: float, low: float) -> float:
    return math.log(high / low) if low > 0.0 else math.inf
