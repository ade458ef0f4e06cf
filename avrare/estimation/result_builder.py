"""Assembly of a ``Result`` from what an estimator has computed, the same for every estimator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.estimation.plan import Plan
from avrare.estimation.result import Failures, Interval, Result, Worst
from avrare.protocols import Floats
from avrare.rollout.request import Rollouts, total_counts

_MAX_MESSAGES = 5


@dataclass(frozen=True)
class Tally:
    """Totals over all stages of an estimate.

    Attributes:
        rollouts: Starts and branches, each counted as one.
        steps: Simulated steps.
        failures: Failing rollouts.
        errors: Rollouts that ended in an error.
        counts: Names and values of the system's counters.
        messages: The first error messages.
    """

    rollouts: int = 0
    steps: int = 0
    failures: int = 0
    errors: int = 0
    counts: tuple[tuple[str, int], ...] = ()
    messages: tuple[str, ...] = ()

    def plus(self, outcome: Rollouts) -> Tally:
        """Return the totals with one more stage."""
        counts = dict(self.counts)
        for name, value in total_counts([outcome]).items():
            counts[name] = counts.get(name, 0) + value
        return Tally(
            self.rollouts + len(outcome.error),
            self.steps + outcome.simulated_steps,
            self.failures + int(outcome.violated.sum()),
            self.errors + int(outcome.error.sum()),
            tuple(sorted(counts.items())),
            (*self.messages, *outcome.messages)[:_MAX_MESSAGES],
        )


def build_result(
    plan: Plan, estimator: str, tally: Tally, run_probabilities: Floats, *,
    interval_at: Callable[[float], Interval], relative_error: float, health: dict[str, str],
    failures: Failures, worst: Worst, robustness: Floats, column: int = 0, relation: str = "violated",
    diagnostics: Mapping[str, Any] | None = None,
) -> Result:  # fmt: skip
    """Build the result of specification number ``column``; the other arguments are as in ``Result``.

    The probability is the mean of ``run_probabilities``.
    """
    return Result(
        specification=plan.names[column],
        estimator=estimator,
        probability=float(run_probabilities.mean()),
        interval_at=interval_at,
        confidence=plan.confidence,
        run_probabilities=run_probabilities,
        relative_error=relative_error,
        rollouts=tally.rollouts,
        simulated_steps=tally.steps,
        errors=tally.errors,
        health=health,
        failures=failures,
        worst=worst,
        robustness=robustness,
        counts=dict(tally.counts),
        relation=relation,
        diagnostics=dict(diagnostics or {}),
    )


def missing_worst(plan: Plan) -> Worst:
    """Return the least robust rollout of an estimate in which every rollout ended in an error."""
    return Worst(np.zeros((plan.steps + 1, plan.noise.noise_size)), math.nan)
