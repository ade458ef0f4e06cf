"""Checks that raise the health warnings of these estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from avrare.base.health_messages import MESSAGES, fill
from avrare.estimation.result import intervals
from avrare.estimation.result.health import check_errors
from avrare.estimation.result.intervals import Interval
from avrare_estimators.common.health_messages import WARNINGS

__all__ = ["allow_for_roots", "check_errors", "check_runs", "check_weights", "warn"]

FEWEST_ROOTS = 15
LEAST_EFFECTIVE = 15.0
LARGEST_SHARE = 0.3
LARGEST_DEVIATION = 4.0
LARGEST_MEAN_ERROR = 0.5


def warn(name: str, **values: object) -> dict[str, str]:
    """Return one of these warnings, or of the core's, with its text filled in."""
    return fill(MESSAGES | WARNINGS, name, **values)


def check_runs(values: Sequence[float], roots: Sequence[int]) -> dict[str, str]:
    """Return the warnings on splitting runs; ``roots``: first particles that failures descend from."""
    runs, extinct, together = len(values), sum(not value for value in values), sum(roots)
    warnings = warn("single_run") if runs == 1 else {}
    if extinct == runs:
        return warnings | warn("extinct", runs=runs)
    if together < FEWEST_ROOTS or 2 * extinct > runs:
        warnings |= warn("few_roots", roots=together, extinct=extinct, runs=runs)
    return warnings


def allow_for_roots(
    interval_at: Callable[[float], Interval], mean: float, roots: int, particles: int
) -> Callable[[float], Interval]:
    """Return an interval that also holds the exact one of a count as small as that of the first particles."""
    return partial(intervals.hull, interval_at, partial(intervals.scaled_counts, mean, roots, particles))


def check_weights(mean: float, error: float, effective: float, largest: float) -> dict[str, str]:
    """Return the warnings on importance weights.

    Args:
        mean: Mean weight.
        error: Standard error of the mean weight.
        effective: Effective number of failing contributions; 0 without failures.
        largest: The largest contribution's share of the estimate.
    """
    warnings: dict[str, str] = {}
    if abs(mean - 1.0) > LARGEST_DEVIATION * error + 1e-9 or error > LARGEST_MEAN_ERROR * mean:
        reason = f"the mean weight is {mean:.3g} +- {error:.2g} instead of 1"
        warnings |= warn("weight_degenerate", reason=reason)
    if effective == 0.0:
        return warnings | warn("no_failures")
    if effective < LEAST_EFFECTIVE or largest > LARGEST_SHARE:
        warnings |= warn("weight_degenerate", reason=describe_uneven(effective, largest))
    return warnings


def describe_uneven(effective: float, largest: float) -> str:
    """Return the reason to doubt an estimate that rests on few of its weights."""
    few = f"the effective number of failures is {effective:.1f}"
    return f"{few}, the largest weight has a share of {largest:.0%}"
