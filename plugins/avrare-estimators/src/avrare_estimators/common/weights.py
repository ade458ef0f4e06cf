"""Importance weights and measures of their quality. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers


def mixture_log_weights(log_ratio: Floats, share: float) -> Floats:
    """Return log weights of rows that come in part from the target itself (deterministic mixture).

    With ``share`` a of the rows from the target p and the others from q, each row has the weight
    p / (a p + (1 - a) q), whichever it came from (Owen and Zhou 2000); it is at most 1 / a.

    Args:
        log_ratio: (n,) log p/q.
        share: a in [0, 1].
    """
    if share == 0.0:
        return log_ratio
    if share == 1.0:
        return np.zeros_like(log_ratio)
    return -np.logaddexp(math.log(share), math.log1p(-share) - log_ratio)


def effective_size(weights: Floats) -> float:
    """Return Kish's effective size (sum w)^2 / sum w^2; 0 without any weight."""
    largest = float(weights.max(initial=0.0))
    if largest == 0.0:
        return 0.0
    scaled = weights / largest
    return float(scaled.sum() ** 2 / (scaled * scaled).sum())


@dataclass(frozen=True)
class Quality:
    """Quality of the weights of a sample.

    Attributes:
        mean: Mean weight; 1 in expectation.
        standard_error: Standard error of the mean weight.
        effective: Effective size of the sample.
        effective_failures: Effective size of the failing rows, on which the estimate rests.
        largest_share: Share of the largest contribution in the estimate; 0 without failures.
    """

    mean: float
    standard_error: float
    effective: float
    effective_failures: float
    largest_share: float


def quality(weights: Floats, failing: Bools, target_rows: int) -> Quality:
    """Return the quality of weights (n,), the first ``target_rows`` of which were drawn from the target."""
    contributions = weights[failing]
    total = float(contributions.sum())
    return Quality(
        mean=float(weights.mean()),
        standard_error=math.sqrt(stratified_variance(weights, target_rows)),
        effective=effective_size(weights),
        effective_failures=effective_size(contributions),
        largest_share=float(contributions.max()) / total if total > 0.0 else 0.0,
    )


def stratified_variance(values: Floats, target_rows: int) -> float:
    """Return the variance of the mean of ``values``; the first ``target_rows`` are one stratum."""
    strata = [stratum for stratum in (values[:target_rows], values[target_rows:]) if len(stratum) > 1]
    return sum(len(stratum) * float(stratum.var(ddof=1)) for stratum in strata) / len(values) ** 2


def anneal(log_weights: Floats, least: float) -> Floats:
    """Return weights exp(g log w) summing to 1, with the largest g <= 1 of an effective size of ``least``.

    In many dimensions raw weights rest on a single row, and a law fitted to one row is of no use. The fitted
    law only decides from where to draw; the estimate itself uses the true weights.
    """

    def raise_to(exponent: float) -> Floats:
        weights = np.exp(exponent * (log_weights - log_weights.max()))
        return np.asarray(weights / weights.sum())

    if effective_size(raise_to(1.0)) >= least:
        return raise_to(1.0)
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective_size(raise_to(middle)) >= least else (low, middle)
    return raise_to(low)


def resample(weights: Floats, count: int, uniform: float) -> Integers:
    """Choose indices (count,) in proportion to ``weights``, systematically from one ``uniform`` in (0, 1)."""
    steps = (np.arange(count) + uniform) / count
    cumulative = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(cumulative, steps), len(weights) - 1).astype(np.int64)
