"""Confidence intervals of a probability; where there were errors, the upper bound counts them as failures."""

from __future__ import annotations

import math

from avrare.base.special_functions import beta_quantile, bisect, normal_factor, t_factor

Interval = tuple[float, float]
_WIDEST = 700.0
"""Largest exponent: exp is still finite there."""


def unknown(confidence: float) -> Interval:
    """Return [0, 1]: no failure was observed, so nothing is known."""
    return 0.0, 1.0


def clopper_pearson(failures: int, trials: int, confidence: float, errors: int = 0) -> Interval:
    """Return the exact binomial interval (Clopper and Pearson 1934), one-sided at 0 and at all failures."""
    tail = 1.0 - confidence
    lower_tail = tail if failures == trials else tail / 2.0
    worst = failures + errors
    upper_tail = tail if worst == 0 else tail / 2.0
    low = 0.0 if failures == 0 else beta_quantile(lower_tail, failures, trials - failures + 1)
    high = 1.0 if worst == trials else beta_quantile(1.0 - upper_tail, worst + 1, trials - worst)
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
    """Return a and b of the mixing Beta law of ``anytime``: mean ``around``, as broad as one failure."""
    return 1.0, (1.0 - around) / around


def anytime(failures: int, trials: int, confidence: float, errors: int = 0, *, around: float) -> Interval:
    """Return an interval valid after all rollouts at once, tightest for probabilities near ``around``.

    It is a beta-mixture confidence sequence (Robbins 1970).
    """
    _, b = mixture(around)
    least = -math.log(1.0 - confidence)

    def mixed(failed: int) -> float:
        # log B(1 + failed, b + held) / B(1, b): a difference of log-gammas would cancel for a huge b
        begun = b + trials - failed
        return (
            math.lgamma(1 + failed) + math.log(b) - math.fsum(math.log(begun + i) for i in range(failed + 1))
        )

    def evidence(failed: int, p: float) -> float:
        # log of the likelihood of the mixture over that of p
        held = trials - failed
        log_p = (failed * math.log(p) if failed else 0.0) + (held * math.log1p(-p) if held else 0.0)
        return of_mixture[failed] - log_p

    low, high, worst = 0.0, 1.0, failures + errors
    of_mixture = {failed: mixed(failed) for failed in {failures, worst}}
    if failures:
        low = bisect(lambda p: -evidence(failures, p) if p else -math.inf, -least, 0.0, failures / trials)
    if worst < trials:
        high = bisect(lambda p: evidence(worst, p) if p < 1.0 else math.inf, least, worst / trials, 1.0)
    return low, high


def log_normal(
    mean: float, relative_variance: float, confidence: float, *, freedom: int, errors: float = 0.0
) -> Interval:
    """Return mean * exp(+-factor * sqrt(log(1 + relative variance))) ("t delta-log", docs/statistics.md).

    ``freedom`` is that of Student's t, runs - 1; 0: the variance counts as known. ``errors`` is a share.
    """
    factor = t_factor(confidence, freedom) if freedom else normal_factor(confidence)
    width = min(factor * math.sqrt(math.log1p(relative_variance)), _WIDEST)
    return mean * math.exp(-width), min(1.0, mean * math.exp(width) + errors)
