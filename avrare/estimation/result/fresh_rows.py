"""Rollouts drawn from the target law: they see every failure, whatever a score or a proposal misses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.rollout.request import Rollouts


@dataclass(frozen=True)
class FreshRows:
    """Counts of independent rollouts of the target.

    Attributes:
        rows: Number of rollouts.
        failures: Number that failed.
        errors: Number that broke down.
    """

    rows: int = 0
    failures: int = 0
    errors: int = 0

    def plus(self, rollouts: Rollouts) -> FreshRows:
        """Return the counts with these rollouts, all of them drawn from the target."""
        failures, errors = int(rollouts.violated[:, 0].sum()), int(rollouts.error.sum())
        return self + FreshRows(len(rollouts.error), failures, errors)

    def __add__(self, other: FreshRows) -> FreshRows:
        """Pool two sets of rollouts."""
        return FreshRows(self.rows + other.rows, self.failures + other.failures, self.errors + other.errors)

    def interval(self, confidence: float) -> Interval:
        """Return the exact interval of the failure probability; [0, 1] without any row."""
        if not self.rows:
            return intervals.unknown(confidence)
        return intervals.clopper_pearson(self.failures, self.rows, confidence, errors=self.errors)

    def interval_of_zero(self) -> Callable[[float], Interval]:
        """Return the interval, as a function of the confidence, of an estimate of 0.

        A failure that the estimate lost raises its upper end.
        """
        if not self.rows:
            return intervals.unknown
        return partial(intervals.clopper_pearson, 0, self.rows, errors=self.failures + self.errors)

    def blind_bound(self, confidence: float) -> float:
        """Return the upper bound for failures of any kind, and so for those that a score does not lead to."""
        return self.interval(confidence)[1]


NO_ROWS = FreshRows()
