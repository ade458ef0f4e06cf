"""Verdicts: whether an estimate's interval, and the failures that it could not see, lie below a threshold."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Literal, get_args

from avrare.base.number_format import format_probability
from avrare.estimation.result.result import Result
from avrare.scenario.schema import Threshold

Verdict = Literal["fail", "inconclusive", "pass_assuming", "pass"]
"""Verdicts, the worst first.

``pass_assuming``: the interval lies below the bound, but failures that the score does not lead to need not.
"""
PASSING = ("pass_assuming", "pass")
_ABOUT_SYSTEM = frozenset({"all_failed", "errors", "horizon_short", "solver_failures"})
"""Warnings about the system, which say nothing against a lower bound of its failures."""


def judge(result: Result, threshold: Threshold) -> Verdict:
    """Return the verdict of an estimate on a threshold: no warned one passes, and none in doubt fails."""
    low, high = result.interval_at(threshold.confidence)
    if is_below(high, threshold.limit, threshold.strict):
        return "inconclusive" if result.health else grade_pass(result, threshold)
    if is_above(low, threshold.limit, threshold.strict):
        return "inconclusive" if find_doubts(result.health) else "fail"
    return "inconclusive"


def find_doubts(health: Iterable[str]) -> frozenset[str]:
    """Return those of an estimate's warnings that doubt the estimate, and not only the system."""
    return frozenset(health) - _ABOUT_SYSTEM


def is_below(end: float, limit: float, strict: bool) -> bool:
    """Return whether the end of an interval lies below a limit, or at it unless ``strict``."""
    return end < limit or (end == limit and not strict)


def is_above(end: float, limit: float, strict: bool) -> bool:
    """Return whether the end of an interval breaks a limit: above it, or at it where it is ``strict``."""
    return end > limit or (end == limit and strict)


def grade_pass(result: Result, threshold: Threshold) -> Verdict:
    """Return the verdict of an interval below a threshold, by the failures that nothing led to.

    "pass" where their upper bound lies below the threshold, too; else "pass_assuming", or "inconclusive"
    where the scenario counts them.
    """
    if result.blind_bound is None or is_below(result.blind_bound, threshold.limit, threshold.strict):
        return "pass"
    return "pass_assuming" if threshold.blind == "assumed" else "inconclusive"


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
