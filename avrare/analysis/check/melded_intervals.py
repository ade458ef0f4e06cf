"""Melded comparison of two estimates: p-values and intervals of the ratio of their probabilities.

Melding (Fay, Proschan and Brittain, "Combining one-sample confidence procedures for inference in the
two-sample case", Biometrics 71 (2015)) draws each one-sided limit at a level of its own, uniform and
independent; the p-value of "new is at most r times old" is the chance that the lower limit of the new falls
below r times the upper limit of the old. For two binomials and r = 1 that is Fisher's exact test, zero counts
included; for two log-normal estimates it is the comparison of their logarithms with their own standard
errors (Behrens and Fisher). The two estimates may have different laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from avrare.estimation.result.confidence_distributions import ConfidenceDistribution

Law = Callable[[float], float]
_Cells = Sequence[tuple[float, float, float]]
"""(from, to, mass) of each cell of a discretised law."""


def p_value_ratio_at_most(ratio: float, new: ConfidenceDistribution, old: ConfidenceDistribution) -> float:
    """Return the p-value of "new <= ratio x old"; small where new is larger than that."""
    return _integrate(_lower_limit_below(new, ratio), _discretise(_upper_limit_law(old)))


def p_value_ratio_at_least(ratio: float, new: ConfidenceDistribution, old: ConfidenceDistribution) -> float:
    """Return the p-value of "new >= ratio x old"; small where new is smaller than that."""
    return _integrate(_upper_limit_above(new, ratio), _discretise(old.p_value_at_most))


def ratio_interval(
    confidence: float, new: ConfidenceDistribution, old: ConfidenceDistribution
) -> tuple[float, float]:
    """Return the interval of new / old; 0 and infinity where an end is unbounded."""
    tail = (1.0 - confidence) / 2.0
    points = 96  # enough for an interval that is only shown
    upper = _discretise(_upper_limit_law(old), points)
    lower = _discretise(old.p_value_at_most, points)
    low = _bisect_ratio(lambda ratio: _integrate(_lower_limit_below(new, ratio), upper) <= tail)
    high = _bisect_ratio(lambda ratio: _integrate(_upper_limit_above(new, ratio), lower) > tail)
    return low, high


def _upper_limit_law(old: ConfidenceDistribution) -> Law:
    return lambda value: 1.0 - old.p_value_at_least(value)


def _lower_limit_below(new: ConfidenceDistribution, ratio: float) -> Law:
    return lambda value: new.p_value_at_most(min(1.0, ratio * value))


def _upper_limit_above(new: ConfidenceDistribution, ratio: float) -> Law:
    return lambda value: 1.0 if ratio * value <= 0.0 else new.p_value_at_least(min(1.0, ratio * value))


def _discretise(law: Law, points: int = 384) -> _Cells:
    edge = 1e-7  # mass of the old estimate beyond either end of the grid
    # 1. A geometric grid between the quantiles at the edges.
    first, last = _quantile(law, edge), _quantile(law, 1.0 - edge)
    grid = np.geomspace(first, last, points).tolist()
    # 2. The mass of each cell; empty ones are dropped.
    reached = [law(point) for point in grid]
    cells = [
        (grid[i], grid[i + 1], mass) for i in range(points - 1) if (mass := reached[i + 1] - reached[i]) > 0.0
    ]
    # 3. The two edges; all mass lies there where the estimate excludes nothing.
    return [(0.0, first, reached[0]), *cells, (last, 1.0, 1.0 - reached[-1])]


def _integrate(chance: Law, cells: _Cells) -> float:
    # The mean of ``chance``, by trapezia; at the edges its larger value
    ends = sum(
        mass * max(chance(low), chance(high)) for low, high, mass in (cells[0], cells[-1]) if mass > 0.0
    )
    chances: dict[float, float] = {}  # neighbours share a point
    for low, high, _ in cells[1:-1]:
        chances |= {point: chance(point) for point in (low, high) if point not in chances}
    inner = sum(mass * 0.5 * (chances[low] + chances[high]) for low, high, mass in cells[1:-1])
    return min(1.0, inner + ends)


def _quantile(law: Law, level: float) -> float:
    # Bisection of the logarithm; 1 if ``law`` does not reach the level
    low, high = -690.0, 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if law(math.exp(middle)) < level else (low, middle)
    return math.exp(high)


def _bisect_ratio(holds: Callable[[float], bool]) -> float:
    largest = 60.0  # log ratios beyond it count as infinite
    low, high = -largest, largest
    if not holds(math.exp(low)):
        return 0.0
    if holds(math.exp(high)):
        return math.inf
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(math.exp(middle)) else (low, middle)
    return math.exp(low)
