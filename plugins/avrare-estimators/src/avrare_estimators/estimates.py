"""From weighted samples to a result: mean, interval, diagnostics and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from statistics import median
from typing import Any

import numpy as np

from avrare.estimation import health, intervals
from avrare.estimation.montecarlo import FAILURE_LIMIT
from avrare.estimation.plan import Plan
from avrare.estimation.result import Failures, Interval, Result, Worst
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.sampling import Sample
from avrare_estimators.second_look import Seen
from avrare_estimators.splitting import Tally
from avrare_estimators.weights import Quality, quality, stratified_variance

DISTRUST = {"no_failures", "weight_degenerate", "cross_check", "unreached"}
"""Warnings under which the interval does not rest on the weights."""


@dataclass(frozen=True)
class RunOutcome:
    """One run.

    Attributes:
        sample: The final sample.
        looked: A second look was asked for.
        seen: What the second look found; None where there was none, or it did not come to failure.
        stages: What was learnt from, one entry a stage.
    """

    sample: Sample
    looked: bool
    seen: Seen | None
    stages: tuple[dict[str, Any], ...]

    @cached_property
    def weights(self) -> Floats:
        """(n,)."""
        return np.asarray(np.exp(self.sample.log_weights))

    @cached_property
    def contributions(self) -> Floats:
        """(n,) weight of the failing rows, 0 for the others."""
        return np.where(self.sample.violated, self.weights, 0.0)

    @property
    def probability(self) -> float:
        """Unbiased, but for the cut at 1."""
        return min(1.0, float(self.contributions.mean()))

    @property
    def undecided(self) -> float:
        """Weight of the rows that broke down."""
        return float(np.where(self.sample.error, self.weights, 0.0).mean())

    def variance(self, unit: float) -> float:
        """Of ``probability`` in units of ``unit``."""
        return stratified_variance(self.contributions / unit, self.sample.target_rows)

    @property
    def unreached(self) -> bool:
        """Learning ended short of failure."""
        return bool(self.stages) and not self.stages[-1]["reached"]


def summarise(
    name: str, plan: Plan, runs: Sequence[RunOutcome], tally: Tally, first: Floats | None,
    noise_size: int | None,
) -> Result:  # fmt: skip
    """The result of finished runs; ``noise_size`` where the user's problem reads fewer numbers a step."""
    values = np.array([run.probability for run in runs])
    marks = _quality(runs)
    warnings = _health(plan, runs, marks, tally)
    return Result(
        specification=plan.names[0],
        estimator=name,
        probability=float(values.mean()),
        interval_at=_bounds(runs, values, marks, trusted=not DISTRUST & warnings.keys()),
        confidence=plan.confidence,
        run_probabilities=values,
        relative_error=math.sqrt(_relative_variance(runs, values)),
        rollouts=tally.rollouts,
        simulated_steps=tally.steps,
        errors=tally.errors,
        health=warnings,
        failures=_failures(plan, runs, tally, noise_size),
        worst=_worst(plan, runs, noise_size),
        robustness=first if first is not None else np.zeros(0),
        counts=dict(tally.counts),
        diagnostics=_diagnostics(runs, marks),
    )


def _quality(runs: Sequence[RunOutcome]) -> Quality:
    """Of the weights of all runs together; the target's rows first, as in each run."""
    order = [
        np.concatenate([getattr(run, field)[part(run)] for part in _PARTS for run in runs])
        for field in ("weights", "contributions")
    ]
    return quality(order[0], order[1] > 0.0, sum(run.sample.target_rows for run in runs))


_PARTS: tuple[Callable[[RunOutcome], slice], ...] = (
    lambda run: slice(0, run.sample.target_rows),
    lambda run: slice(run.sample.target_rows, None),
)


def _health(plan: Plan, runs: Sequence[RunOutcome], marks: Quality, tally: Tally) -> dict[str, str]:
    found = health.of_weights(
        marks.mean, marks.standard_error, marks.effective_failures, marks.largest_share, *_contradiction(runs)
    )
    if any(run.unreached for run in runs):
        found |= health.warn("unreached", stages=max(len(run.stages) for run in runs))
    if marks.effective_failures > 0.0 and any(run.looked and run.seen is None for run in runs):
        found |= health.warn("unchecked")
    if all(run.sample.violated.all() for run in runs):
        found |= health.warn("all_failed")
    return found | health.of_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)


def _contradiction(runs: Sequence[RunOutcome]) -> tuple[float, float]:
    """Surprise, the largest of the runs' and of what they say together, and their median share of unseen.

    0 where nobody has looked.
    """
    looks = [run.seen for run in runs if run.seen is not None]
    if not looks:
        return 0.0, 0.0
    each = [seen.surprise for seen in looks]
    return max(*each, sum(each) / math.sqrt(len(each)), 0.0), median(seen.unseen for seen in looks)


def _relative_variance(runs: Sequence[RunOutcome], values: Floats) -> float:
    """Of the mean; NaN where all runs are zero."""
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    # Divided first: the square of a tiny estimate is 0.
    within = sum(run.variance(mean) for run in runs) / len(runs) ** 2
    spread = float((values / mean).var(ddof=1)) / len(runs) if len(runs) > 1 else within
    return spread or within


def _bounds(
    runs: Sequence[RunOutcome], values: Floats, marks: Quality, trusted: bool
) -> Callable[[float], Interval]:
    """The interval as a function of the confidence."""
    mean, undecided = float(values.mean()), float(np.mean([run.undecided for run in runs]))
    if not trusted:
        rows = sum(run.sample.target_rows for run in runs)
        failed = sum(int(run.sample.violated[: run.sample.target_rows].sum()) for run in runs)
        broken = sum(int(run.sample.error[: run.sample.target_rows].sum()) for run in runs)
        return partial(_whatever_the_weights, mean, failed, broken, rows)
    freedom = len(runs) - 1 if len(runs) > 1 else max(1, int(marks.effective_failures) - 1)
    return partial(
        intervals.log_normal, mean, _relative_variance(runs, values), freedom=freedom, undecided=undecided
    )


def _whatever_the_weights(mean: float, failed: int, broken: int, rows: int, confidence: float) -> Interval:
    """What holds for any weights: Markov's inequality below, the target's own rows above.

    The estimate is unbiased and not negative, so it exceeds p / a with probability at most a, however badly
    the weights are distributed; and the rows that were drawn from the target are plain Monte Carlo.
    """
    tail = (1.0 - confidence) / 2.0
    low = tail * mean
    if not rows:
        return low, 1.0
    each_side = 1.0 - tail if mean > 0.0 else confidence
    high = intervals.clopper_pearson(failed, rows, each_side, undecided=broken)[1]
    return low, max(high, mean)


def _diagnostics(runs: Sequence[RunOutcome], marks: Quality) -> dict[str, Any]:
    found: dict[str, Any] = {
        "mean_weight": marks.mean,
        "mean_weight_error": marks.standard_error,
        "effective_size": marks.effective,
        "effective_failures": marks.effective_failures,
        "largest_share": marks.largest_share,
        "second_look": [None if run.seen is None else vars(run.seen) for run in runs],
        "target_rows": [run.sample.target_rows for run in runs],
        "rows": [len(run.sample.error) for run in runs],
    }
    if any(run.stages for run in runs):
        found["stages"] = [list(run.stages) for run in runs]
    return found


def _replayable(run: RunOutcome, chosen: Bools) -> Integers:
    """Rows among ``chosen`` whose tapes mean the same to the user's problem: all, or the target's."""
    rows = np.flatnonzero(chosen)
    return rows if run.sample.source.replayable else rows[rows < run.sample.target_rows]


def _failures(plan: Plan, runs: Sequence[RunOutcome], tally: Tally, noise_size: int | None) -> Failures:
    tapes, robustness, room = [], [], FAILURE_LIMIT
    for run in runs:
        rows = _replayable(run, run.sample.violated)[:room]
        tapes.append(run.sample.tapes(rows)[..., :noise_size])
        robustness.append(run.sample.robustness[rows])
        room -= len(rows)
    return Failures(np.concatenate(tapes), np.concatenate(robustness), tally.failures)


def _worst(plan: Plan, runs: Sequence[RunOutcome], noise_size: int | None) -> Worst:
    best = Worst(np.zeros((plan.steps + 1, plan.noise.noise_size))[:, :noise_size], math.nan)
    for run in runs:
        rows = _replayable(run, ~run.sample.error)
        if not len(rows):
            continue
        row = rows[[int(np.argmin(run.sample.robustness[rows]))]]
        least = float(run.sample.robustness[row[0]])
        if not least >= best.robustness:
            best = Worst(run.sample.tapes(row)[0][:, :noise_size], least)
    return best
