"""Doubts of an estimate, and the one place where they open its interval."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial

from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Result

MAY_MISS_FAILURES = frozenset(
    {
        "extinct",
        "no_failures",
        "few_roots",
        "leaps",
        "unchecked",
        "flat_part",
        "outliers",
        "model_unknown",
    }
)
"""Warnings under which the estimate may be too low."""
MAY_SCATTER = frozenset({"weight_degenerate", "contradicted", "heuristic_kernel"})
"""Warnings under which it may be too high as well."""
FAR_OFF = 3.0
"""Factor between an estimate's interval and its blind bound above which failures may be missed."""
DOUBTS = MAY_MISS_FAILURES | MAY_SCATTER


def open_interval(result: Result, warnings: Collection[str], least_upper: float = 0.0) -> Result:
    """Return a result whose interval holds whatever its warnings doubt; one that is open already only widens.

    The upper end is at least the exact one of all rollouts drawn from the target, and the bound of a check.
    The lower end, where the estimate may be too high, is that of Markov's inequality: an unbiased estimate
    that is not negative exceeds p / a with probability at most a.

    Args:
        result: The result, with the interval that its runs or weights give.
        warnings: Names of all its warnings, also of those that are not shown.
        least_upper: Probability that a check of the estimate allows.
    """
    doubts = DOUBTS.intersection(warnings)
    if not doubts or result.fresh is None:
        return result
    scatters, mean, at = bool(MAY_SCATTER & doubts), result.probability, result.interval_at
    if "weight_degenerate" in doubts and result.unopened_at is None:  # their scatter says nothing
        at = partial(_point, mean)
    least_upper = max(least_upper, result.least_upper)
    opened = partial(_open, mean, at, result.fresh, scatters, least_upper)
    unopened = result.unopened_at or result.interval_at
    return replace(result, interval_at=opened, unopened_at=unopened, least_upper=least_upper)


def answer_doubts(result: Result) -> Result:
    """Return a result whose doubts of missed failures are notes where its rollouts of the target answer them.

    They do where opening the interval for the doubt raises its upper end at most threefold.
    """
    doubts = MAY_MISS_FAILURES.intersection(result.health)
    if not doubts or not result.probability or result.unopened_at is None or result.fresh is None:
        return result
    high, rows = result.interval[1], result.fresh.rows
    if high > FAR_OFF * result.unopened_at(result.confidence)[1]:
        return result
    text = f"The interval ends at what {rows:,} rollouts of the target allow, which see every failure: "
    notes = (Note("doubt", f"{text}{result.health[name]}.") for name in sorted(doubts))
    health = {name: warning for name, warning in result.health.items() if name not in doubts}
    return replace(result, health=health, notes=(*result.notes, *notes))


def undo_opening(result: Result) -> Result:
    """Return a result with the interval that its runs or weights gave."""
    return replace(result, interval_at=result.unopened_at or result.interval_at, unopened_at=None)


def _open(
    mean: float,
    interval_at: Callable[[float], Interval],
    fresh: FreshRows,
    scatters: bool,
    least_upper: float,
    confidence: float,
) -> Interval:
    (low, high), counted = interval_at(confidence), fresh.interval(confidence)
    if scatters:
        low = min(low, counted[1], (1.0 - confidence) / 2.0 * mean)
    return low, max(high, counted[1], least_upper)


def _point(mean: float, confidence: float) -> Interval:
    return mean, mean
