"""Verdicts: whether an estimate's interval, and the failures that it could not see, lie below a threshold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Literal, Protocol, get_args

from avrare.base.number_format import format_probability
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.scenario.schema import Threshold

Verdict = Literal["fail", "inconclusive", "pass_assuming", "pass"]
"""Verdicts, the worst first.

``pass_assuming``: the interval lies below the bound, but failures that the score does not lead to need not.
"""
PASSING = ("pass_assuming", "pass")
_ABOUT_SYSTEM = frozenset({"all_failed", "errors", "horizon_short", "solver_failures"})
"""Warnings about the system, which say nothing against a lower bound of its failures."""


Side = Literal["below", "above", "across"]
"""Side of a limit on which an interval lies; "across": on neither."""


class Bound(Protocol):
    """Upper bound of a probability or rate."""

    @property
    def limit(self) -> float:
        """Bound as a number."""

    @property
    def strict(self) -> bool:
        """True for ``<``, False for ``<=``."""

    @property
    def blind(self) -> Literal["assumed", "counted"]:
        """Treatment of failures that no score leads to, as in ``Threshold``."""


def decide(side: Side, warned: bool, doubted: bool, best: Verdict = "pass") -> Verdict:
    """Return the verdict of an estimate: with a warning it cannot pass, in doubt it cannot fail.

    Args:
        side: Side of the limit on which it lies.
        warned: True if a warning keeps it from passing.
        doubted: True if a warning casts doubt on the estimate, not only on the system (``find_doubts``).
        best: Best verdict that the bound on failures never approached allows (``grade_blind``).
    """
    if side == "across" or (doubted if side == "above" else warned):
        return "inconclusive"
    return "fail" if side == "above" else best


def judge(result: Result, threshold: Threshold) -> Verdict:
    """Return the verdict of an estimate on a threshold."""
    side = find_side(result.interval_at(threshold.confidence), threshold)
    doubted = bool(find_doubts(result.health))
    return decide(side, bool(result.health), doubted, grade_blind(result.blind_bound, threshold))


def find_side(interval: Interval, bound: Bound) -> Side:
    """Return the side of a bound on which an interval lies."""
    low, high = interval
    if is_below(high, bound):
        return "below"
    return "above" if low > bound.limit or (low == bound.limit and bound.strict) else "across"


def is_below(end: float, bound: Bound) -> bool:
    """Return whether the upper end of an interval keeps to a bound."""
    return end < bound.limit or (end == bound.limit and not bound.strict)


def grade_blind(blind_bound: float | None, bound: Bound) -> Verdict:
    """Return the best verdict that failures which nothing led to allow.

    "pass" where their upper bound keeps to the bound, too; else "pass_assuming", or "inconclusive" where the
    scenario counts them.
    """
    if blind_bound is None or is_below(blind_bound, bound):
        return "pass"
    return "pass_assuming" if bound.blind == "assumed" else "inconclusive"


def find_doubts(health: Iterable[str]) -> frozenset[str]:
    """Return the warnings that cast doubt on an estimate, not only on the system."""
    return frozenset(health) - _ABOUT_SYSTEM


def describe_assumption(blind_bound: float) -> str:
    """Return the reason of a ``pass_assuming``."""
    unseen = f"failures that nothing led to could be up to {format_probability(blind_bound)}"
    return f"holds as far as the search could see; {unseen}"


def with_verdict(result: Result, thresholds: Iterable[Threshold]) -> Result:
    """Return the result with its worst verdict on those thresholds of a scenario that are its own."""
    verdicts = [
        judge(result, threshold)
        for threshold in thresholds
        if threshold.specification == result.specification
    ]
    return replace(result, verdict=worst_verdict(verdicts))


def worst_verdict(verdicts: Iterable[str | None]) -> str | None:
    """Return the worst of several verdicts, or None if there is none."""
    present = set(verdicts)
    return next((verdict for verdict in get_args(Verdict) if verdict in present), None)
