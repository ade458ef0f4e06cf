"""Requirement: the largest (or smallest) value of a parameter that keeps a probability below a bound.

The estimates at several values have intervals that hold together: each is at the level 1 - alpha / m, for m
estimates at most (Bonferroni), and each has noise of its own, so the values may be chosen from what came
before. If the probability is monotone in the parameter, the value at which it reaches the bound then lies
between the last value that is shown to keep the bound and the first that is shown to break it, with the
confidence 1 - alpha. Values are chosen by a line through log p, as near to its root as the next estimate can
tell apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Records
from avrare.estimation.intervals import Interval

SHARES = (1, 1, 1, 1, 2, 2, 4, 4)
"""Parts of the budget of the estimates: the first two at the ends, the last ones decide."""
_MARGIN = 1.3
"""Distance from the root at which the next value is taken, in half widths of the interval there."""
_NARROW = 0.02
"""Relative width of the answer from which on it is not narrowed any further."""
_LEAST_SLOPE = 1e-3


@dataclass(frozen=True)
class Trial:
    """Estimate at one value of the parameter.

    Attributes:
        value: The value.
        probability: The estimate.
        interval: Its interval, at the level of all trials together.
        rollouts: Rollouts that it took.
        warnings: Names of its health warnings.
    """

    value: float
    probability: float
    interval: Interval
    rollouts: int
    warnings: tuple[str, ...] = ()


Evaluate = Callable[[float, float, int, float], Trial]
"""Called with a value, a share of the budget, the number of the trial, and the level of its interval."""


@dataclass(frozen=True, repr=False)
class Requirement:
    """Requirement on one parameter.

    Attributes:
        parameter: Its dotted path.
        specification: Specification whose probability is bounded.
        limit: The bound.
        kept: Value nearest to the root that is shown to keep the bound; None: no value was.
        broken: Value nearest to the root that is shown to break it; None: no value was.
        root: Value at which the fitted line reaches the bound; None where it does not between the ends.
        confidence: Level of the statement.
        trials: Estimates, in the order in which they were made.
        rising: The probability rises with the parameter.
        warnings: Reasons to doubt it.
    """

    parameter: str
    specification: str
    limit: float
    kept: float | None
    broken: float | None
    root: float | None
    confidence: float
    trials: tuple[Trial, ...]
    rising: bool
    warnings: tuple[str, ...] = field(default=())

    @property
    def rollouts(self) -> int:
        """Rollouts of all trials."""
        return sum(trial.rollouts for trial in self.trials)

    def table(self) -> Records:
        """Return one row for each trial, in the order of the parameter."""
        return Records(
            {
                "value": one.value, "probability": one.probability, "low": one.interval[0],
                "high": one.interval[1], "rollouts": one.rollouts, "warnings": one.warnings,
            }
            for one in sorted(self.trials, key=lambda one: one.value)
        )  # fmt: skip

    def lines(self) -> list[str]:
        """Return the answer in words, and the trials."""
        found = [self._answer()]
        found += [
            f"  {self.parameter} = {one.value:.4g}: {format_probability(one.probability)} "
            f"({format_interval(one.interval)}), {one.rollouts:,} rollouts"
            + (f", {', '.join(one.warnings)}" if one.warnings else "")
            for one in sorted(self.trials, key=lambda one: one.value)
        ]
        return [*found, *(f"warning: {text}" for text in self.warnings)]

    def _answer(self) -> str:
        bound = f"p({self.specification}) < {self.limit:g}"
        most = "at most" if self.rising else "at least"
        level = f"{100 * self.confidence:g} % confidence"
        if self.kept is None:
            values = f"{min(one.value for one in self.trials):g} .. {max(one.value for one in self.trials):g}"
            return f"{self.parameter}: no value in {values} is shown to keep {bound} ({level})"
        text = f"{self.parameter} must be {most} {self.kept:.4g} for {bound} ({level}"
        if self.broken is None:
            return f"{text}); no value was shown to break it"
        return f"{text}, if p is monotone in it); {self.broken:.4g} breaks it"

    def __repr__(self) -> str:
        return "\n".join(self.lines())


def find_requirement(
    evaluate: Evaluate, parameter: str, specification: str, limit: float, between: tuple[float, float], *,
    confidence: float = 0.95, logarithmic: bool = True,
) -> Requirement:  # fmt: skip
    """Find the value of a parameter at which a probability reaches ``limit``.

    Args:
        evaluate: Estimates the probability at a value.
        parameter: Name, for the answer.
        specification: Name, for the answer.
        limit: The bound, in (0, 1).
        between: Smallest and largest value to try.
        confidence: Level of the answer.
        logarithmic: Look along the logarithm of the parameter, where both ends are positive.

    Raises:
        UsageError: The bound or the ends do not fit.
    """
    low, high = between
    if not 0.0 < limit < 1.0 or not -math.inf < low < high < math.inf:
        raise UsageError(f"{parameter}: bound {limit:g} between {low:g} and {high:g} cannot be searched")
    scaled = logarithmic and low > 0.0
    level = 1.0 - (1.0 - confidence) / len(SHARES)
    trials: list[Trial] = []
    for number, share in enumerate(np.array(SHARES) / sum(SHARES)):
        value = between[number] if number < 2 else _choose(trials, limit, scaled, number)
        if value is None:
            break
        trials.append(evaluate(value, float(share), number, level))
        sides = {one.interval[1] < limit or (one.interval[0] > limit and None) for one in trials}
        if number == 1 and sides in ({True}, {None}):  # both ends keep the bound, or both break it
            break
    rising = _rises(trials)
    kept, broken = _bracket(trials, limit)
    line = _fit(trials, limit, scaled)
    root = None if line is None else _from(line[0], scaled)
    return Requirement(
        parameter, specification, limit, kept, broken,
        root if root is not None and low <= root <= high else None, confidence, tuple(trials), rising,
        _doubts(trials, limit, rising),
    )  # fmt: skip


def _rises(trials: list[Trial]) -> bool:
    first, second = trials[0], trials[1] if len(trials) > 1 else trials[0]
    return (second.probability - first.probability) * (second.value - first.value) >= 0.0


def _bracket(trials: list[Trial], limit: float) -> tuple[float | None, float | None]:
    rising = _rises(trials)
    kept = [one.value for one in trials if one.interval[1] < limit]
    broken = [one.value for one in trials if one.interval[0] > limit]
    inner, outer = (max, min) if rising else (min, max)
    return inner(kept, default=None), outer(broken, default=None)


def _choose(trials: list[Trial], limit: float, scaled: bool, number: int) -> float | None:
    kept, broken = _bracket(trials, limit)
    ends = sorted(_to(one.value, scaled) for one in trials[:2])
    if kept is not None and broken is not None:
        ends = sorted((_to(kept, scaled), _to(broken, scaled)))
        if abs(kept - broken) <= _NARROW * max(abs(kept), abs(broken)):
            return None
    middle = 0.5 * (ends[0] + ends[1])
    line = _fit(trials, limit, scaled)
    if line is None or number == 2:
        return _from(middle, scaled)
    root, slope = line
    # The half width of the next interval in log p: that of the last trial at a budget of its own.
    last = trials[-1]
    width = math.log(last.interval[1] / max(last.probability, last.interval[1] / 100.0))
    width *= math.sqrt(SHARES[number - 1] / SHARES[number])
    side = (-1.0 if number % 2 else 1.0) * (1.0 if slope > 0 else -1.0)
    point = root + side * _MARGIN * width / max(abs(slope), _LEAST_SLOPE)
    inside = ends[0] < point < ends[1]
    return _from(point if inside else middle, scaled)


def _fit(trials: list[Trial], limit: float, scaled: bool) -> tuple[float, float] | None:
    # Root and slope of a line through log p, weighted by its precision and nearness to the bound.
    rows = [one for one in trials if 0.0 < one.probability < 1.0]
    if len(rows) < 2:
        return None
    x = np.array([_to(one.value, scaled) for one in rows])
    y = np.array([math.log(one.probability / limit) for one in rows])
    spread = np.array(
        [math.log(one.interval[1] / max(one.interval[0], one.interval[1] * 1e-4)) for one in rows]
    )
    weight = 1.0 / (np.maximum(spread, 1e-3) ** 2 * (1.0 + y**2))
    centre = float((weight * x).sum() / weight.sum())
    square = float((weight * (x - centre) ** 2).sum())
    if square <= 0.0:
        return None
    slope = float((weight * (x - centre) * y).sum()) / square
    if slope == 0.0:
        return None
    return centre - float((weight * y).sum() / weight.sum()) / slope, slope


def _doubts(trials: list[Trial], limit: float, rising: bool) -> tuple[str, ...]:
    ordered = sorted(trials, key=lambda one: one.value, reverse=not rising)
    found = []
    best = 0.0
    for one in ordered:
        if one.interval[1] < best:
            found.append(
                "the probability is not monotone in the parameter: it falls again towards "
                f"{one.value:.4g}, so the answer holds for the values that were tried alone"
            )
            break
        best = max(best, one.interval[0])
    if any(one.warnings for one in trials):
        found.append("some estimates have health warnings; the answer is no better than they are")
    return tuple(found)


def _to(value: float, scaled: bool) -> float:
    return math.log(value) if scaled else value


def _from(point: float, scaled: bool) -> float:
    return math.exp(point) if scaled else point
