"""One interval of a sum of exposures times probabilities, split into sampling and exposure parts.

The rate is the sum over scenes of e_i p_i, both factors estimated independently. The interval recovers the
variances from the intervals of the parts, each at its own end (MOVER: Zou, Huang and Zhang, A note on
confidence interval estimation for a linear function of binomial proportions, CSDA 53, 2009):

    low = sum e_i p_i - sqrt(sum d_i^2),
    d_i^2 = (e_i (p_i - l_i))^2 + (p_i (e_i - k_i))^2 - ((p_i - l_i) (e_i - k_i))^2

with the lower ends l_i of p_i and k_i of e_i, the variance of a product (Goodman, On the exact variance of
products, JASA 55, 1960); at the upper end the last term is added. Intervals of the parts are Jeffreys'.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import variance

from avrare.analysis.rates.catalogue_document import SceneEntry
from avrare.base.special_functions import normal_factor, t_factor
from avrare.estimation.result.intervals import clopper_pearson
from avrare.scenario.exposure import Exposure

Interval = tuple[float, float]

FEW = 10
"""Failures in all scenes together below which the exact intervals take the place of Jeffreys'."""


@dataclass(frozen=True)
class Quantity:
    """Estimate with its interval, of one level for all quantities of a sum."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Total:
    """Sum of products with its interval, and the interval that each kind of uncertainty alone would give.

    Attributes:
        value: The sum.
        interval: Interval of both together.
        sampling: Interval if the exposures were known.
        exposure: Interval if the probabilities were known.
        shares: Share of each term in the sum; 0 where the sum is 0.
        doubts: Share of each term in the squared half widths of the interval.
    """

    value: float
    interval: Interval
    sampling: Interval
    exposure: Interval
    shares: tuple[float, ...]
    doubts: tuple[float, ...]


def combine(exposures: Sequence[Quantity], probabilities: Sequence[Quantity]) -> Total:
    """Return the sum of exposure times probability over all scenes."""
    pairs = list(zip(exposures, probabilities, strict=True))
    value = math.fsum(e.value * p.value for e, p in pairs)
    terms = [_deviations(e, p) for e, p in pairs]
    of_probabilities = [_deviations(Quantity(e.value, e.value, e.value), p) for e, p in pairs]
    of_exposures = [_deviations(e, Quantity(p.value, p.value, p.value)) for e, p in pairs]
    doubt = [below + above for below, above in terms]
    total = math.fsum(doubt)
    return Total(
        value,
        _around(value, terms),
        _around(value, of_probabilities),
        _around(value, of_exposures),
        tuple(e.value * p.value / value if value else 0.0 for e, p in pairs),
        tuple(width / total if total else 0.0 for width in doubt),
    )


def _deviations(e: Quantity, p: Quantity) -> tuple[float, float]:
    # Squared distances of the lower and of the upper end from e p.
    below = (e.value * (p.value - p.low)) ** 2 + (p.value * (e.value - e.low)) ** 2
    below -= ((p.value - p.low) * (e.value - e.low)) ** 2
    above = (e.value * (p.high - p.value)) ** 2 + (p.value * (e.high - e.value)) ** 2
    above += ((p.high - p.value) * (e.high - e.value)) ** 2
    return max(below, 0.0), above


def _around(value: float, terms: Sequence[tuple[float, float]]) -> Interval:
    below, above = (math.sqrt(math.fsum(term[k] for term in terms)) for k in (0, 1))
    return max(value - below, 0.0), value + above


def from_rollouts(failures: int, rollouts: int, errors: int, confidence: float, few: bool) -> Quantity:
    """Return a probability from counts; the upper end counts errors as failures.

    ``few`` asks for the exact interval in place of Jeffreys'.
    """
    if few:
        return Quantity(failures / rollouts, *clopper_pearson(failures, rollouts, confidence, errors))
    from scipy.special import betaincinv

    tail, worst = (1.0 - confidence) / 2.0, failures + errors
    low = float(betaincinv(failures + 0.5, rollouts - failures + 0.5, tail)) if failures else 0.0
    high = 1.0
    if worst < rollouts:
        high = float(betaincinv(worst + 0.5, rollouts - worst + 0.5, 1.0 - tail))
    return Quantity(failures / rollouts, low, high)


def from_count(count: float, amount: float, confidence: float) -> Quantity:
    """Return the rate of events after ``count`` were seen in ``amount`` hours or km (Jeffreys)."""
    from scipy.special import gammaincinv

    tail = (1.0 - confidence) / 2.0
    low = float(gammaincinv(count + 0.5, tail)) if count else 0.0
    return Quantity(count / amount, low / amount, float(gammaincinv(count + 0.5, 1.0 - tail)) / amount)


def from_blocks(counts: Sequence[int], amount: float, confidence: float) -> Quantity:
    """Return the rate of events that were counted in blocks of ``amount`` hours or km each.

    Their variance may exceed Poisson's: events and driving are divided by its ratio to the mean, times the
    square of Student's t over the normal factor, as that ratio is itself an estimate (Wedderburn 1974).
    """
    total, blocks = sum(counts), len(counts)
    scatter = 1.0
    if total:
        widening = t_factor(confidence, blocks - 1) / normal_factor(confidence)
        scatter = max(variance(counts) * blocks / total, 1.0) * widening**2
    return from_count(total / scatter, blocks * amount / scatter, confidence)


def from_interval(value: float, interval: Interval, given: float, confidence: float) -> Quantity:
    """Return a rate whose interval of level ``given`` is brought to ``confidence`` on the logarithm."""
    factor = normal_factor(confidence) / normal_factor(given)
    low, high = interval
    below = value * math.exp(-factor * math.log(value / low)) if low > 0.0 else 0.0
    return Quantity(value, below, value * math.exp(factor * math.log(high / value)))


def from_scene(entry: SceneEntry, confidence: float) -> Quantity:
    """Return how often a scene occurs, or the number of cells that it represents."""
    if entry.exposure is not None:
        return from_exposure(entry.exposure, confidence)
    cells = float(entry.cells or 0)
    return Quantity(cells, cells, cells)


def from_exposure(exposure: Exposure, confidence: float) -> Quantity:
    """Return how often a scene occurs, per hour or per km, with its interval at a level."""
    amount = exposure.hours or exposure.km or 1.0
    if exposure.count is not None:
        return from_count(exposure.count, amount, confidence)
    if exposure.counts is not None:
        return from_blocks(exposure.counts, amount, confidence)
    value = exposure.per_hour or exposure.per_km or 0.0
    if exposure.interval is None:
        return Quantity(value, value, value)
    return from_interval(value, exposure.interval, exposure.confidence, confidence)
