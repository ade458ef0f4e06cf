"""Settings that all estimators share."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.fresh_rows import NO_ROWS, FreshRows

DEFAULT_MAX_ERROR_RATE = 0.01


@dataclass(frozen=True)
class Settings:
    """Settings that all estimators share.

    Attributes:
        seed: Seed of all random numbers.
        confidence: Level of the intervals, in (0, 1).
        budget: Upper bound on cost.
        max_error_rate: Share of errors among the rollouts above which a result has the warning ``errors``.
        suppress: Names of health warnings to leave out.
        seen: Counts of rollouts of the target from before (``Plan.seen``).
        goal: Relative error for an estimator that is given neither its size nor a budget; None: its own.
    """

    seed: int = 0
    confidence: float = 0.95
    budget: Budget | None = None
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    suppress: tuple[str, ...] = ()
    seen: FreshRows = NO_ROWS
    goal: float | None = None
