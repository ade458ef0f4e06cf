"""Two estimates side by side: is one probability more than so many times the other?

Melding (Fay, Proschan and Brittain, "Combining one-sample confidence procedures for inference in the
two-sample case", Biometrics 71 (2015)): let each one-sided limit be drawn at a level of its own, uniform and
independent; the p-value of "new is at most r times old" is the chance that the lower limit of the new falls
below r times the upper limit of the old. For two binomials and r = 1 that is Fisher's exact test, zero counts
included; for two log-normal estimates it is the comparison of their logarithms with their own standard
errors (Behrens and Fisher); and it takes one of each just as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from avrare.check.evidence import Evidence

_POINTS = 384
_FEW_POINTS = 96
"""Enough for an interval that is shown."""
_EDGE = 1e-7
"""Mass of the old estimate left out at either end; it is counted against the claim."""
_WIDEST = 60.0
"""Logarithm of the largest ratio that is told apart from infinity."""

Law = Callable[[float], float]


def more_than(ratio: float, new: Evidence, old: Evidence) -> float:
    """p-value of "new <= ratio x old": small where new is more than that."""
    return _mean(_below_ratio(new, ratio), _masses(lambda value: 1.0 - old.below(value)))


def less_than(ratio: float, new: Evidence, old: Evidence) -> float:
    """p-value of "new >= ratio x old": small where new is less than that."""
    return _mean(_above_ratio(new, ratio), _masses(old.above))


def ratio_interval(confidence: float, new: Evidence, old: Evidence) -> tuple[float, float]:
    """Between which new / old lies; 0 and infinity where there is no end."""
    tail = (1.0 - confidence) / 2.0
    largest = _masses(lambda value: 1.0 - old.below(value), _FEW_POINTS)
    smallest = _masses(old.above, _FEW_POINTS)
    low = _crossing(lambda ratio: _mean(_below_ratio(new, ratio), largest) <= tail)
    high = _crossing(lambda ratio: _mean(_above_ratio(new, ratio), smallest) > tail)
    return low, high


def _below_ratio(new: Evidence, ratio: float) -> Law:
    return lambda value: new.above(min(1.0, ratio * value))


def _above_ratio(new: Evidence, ratio: float) -> Law:
    return lambda value: 1.0 if ratio * value <= 0.0 else new.below(min(1.0, ratio * value))


def _masses(law: Law, many: int = _POINTS) -> Sequence[tuple[float, float, float]]:
    """(from, to, mass) of a random limit with distribution function ``law`` on [0, 1]."""
    first, last = _quantile(law, _EDGE), _quantile(law, 1.0 - _EDGE)
    points = np.geomspace(first, last, many).tolist()
    reached = [law(point) for point in points]
    parts = [
        (points[i], points[i + 1], mass)
        for i in range(many - 1)
        if (mass := reached[i + 1] - reached[i]) > 0.0
    ]
    # Limits of an estimate that excludes nothing are all at one end.
    return [(0.0, first, reached[0]), *parts, (last, 1.0, 1.0 - reached[-1])]


def _mean(chance: Law, masses: Sequence[tuple[float, float, float]]) -> float:
    """Of ``chance`` over the random limit; at the two ends its larger value counts."""
    ends = sum(
        mass * max(chance(low), chance(high)) for low, high, mass in (masses[0], masses[-1]) if mass > 0.0
    )
    known: dict[float, float] = {}  # neighbours share a point
    for low, high, _ in masses[1:-1]:
        known |= {point: chance(point) for point in (low, high) if point not in known}
    inner = sum(mass * 0.5 * (known[low] + known[high]) for low, high, mass in masses[1:-1])
    return min(1.0, inner + ends)


def _quantile(law: Law, level: float) -> float:
    """Where ``law`` reaches ``level``, by bisection of the logarithm; 1 where it does not."""
    low, high = -690.0, 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if law(math.exp(middle)) < level else (low, middle)
    return math.exp(high)


def _crossing(holds: Callable[[float], bool]) -> float:
    """The ratio up to which ``holds`` is true."""
    low, high = -_WIDEST, _WIDEST
    if not holds(math.exp(low)):
        return 0.0
    if holds(math.exp(high)):
        return math.inf
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(math.exp(middle)) else (low, middle)
    return math.exp(low)
