"""Result of weighted samples: mean, interval, diagnostics and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from avrare.estimation.checks.result_builder import build_result, represent_errors
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result import intervals
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Failures, Result, Worst, spread
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.common import health
from avrare_estimators.common.samples.agreement import compare_checks
from avrare_estimators.common.samples.cross_check import CrossCheckResult
from avrare_estimators.common.samples.sampling import Sample, failing_weights, variance_of_sum
from avrare_estimators.common.samples.stages import has_reached
from avrare_estimators.common.weights import Quality, effective_size, quality


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of one run.

    Attributes:
        sample: The final sample.
        checked: A cross-check was asked for.
        cross_check: Its result; None where there was none.
        stages: Learning stages, one entry each.
        counted: Shares of the estimate that stages of learning have, and their samples. Each share was fixed
            before its sample was drawn, and so was the proposal: every sample alone is unbiased given those
            before it, and with the rest for the final sample so is their sum.
    """

    sample: Sample
    checked: bool
    cross_check: CrossCheckResult | None
    stages: tuple[dict[str, Any], ...]
    counted: tuple[tuple[float, Sample], ...] = ()

    @cached_property
    def weights(self) -> Floats:
        """(n,) weights of the rows."""
        return np.asarray(np.exp(self.sample.log_weights))

    @cached_property
    def contributions(self) -> Floats:
        """(n,) weight of the rows that fail; 0 for the others."""
        return failing_weights(self.sample)

    @cached_property
    def parts(self) -> list[tuple[float, Sample]]:
        """Shares of the estimate and their samples, the final one first."""
        return [(1.0 - sum(share for share, _ in self.counted), self.sample), *self.counted]

    @property
    def probability(self) -> float:
        """Estimate of the run, unbiased except for the cut at 1."""
        return min(1.0, sum(share * float(failing_weights(part).mean()) for share, part in self.parts))

    @property
    def error_weight(self) -> float:
        """Weight of the rows that broke down."""
        return float(
            sum(share * np.where(p.error, np.exp(p.log_weights), 0.0).mean() for share, p in self.parts)
        )

    @property
    def plain(self) -> bool:
        """All rows were drawn from the target: Monte Carlo."""
        return self.sample.share == 1.0

    @property
    def unreached(self) -> bool:
        """Learning ended short of failure."""
        return bool(self.stages) and not has_reached(self.stages[-1]) and not self.plain

    def variance(self, unit: float) -> float:
        """Return the variance of ``probability`` in units of ``unit``."""
        return variance_of_sum(self.parts, unit)

    def shortfall(self, unit: float) -> float:
        """Return the square, in units of ``unit``, by which the cross-check finds more than chance explains.

        A proposal that misses a part of the failures has no row that shows it. For a right check c and a
        sample m the mean of (c - m)^2 is m's bias squared and both variances: what is left is the first.
        """
        check = self.cross_check
        if check is None or not check.probabilities:
            return 0.0
        difference = max(0.0, (check.mean - self.probability) / unit)
        return max(0.0, difference**2 - self.variance(unit) - check.variance(unit))


def summarise(
    name: str,
    plan: Plan,
    runs: Sequence[RunOutcome],
    tally: Info,
    first: Floats | None,
    fresh: FreshRows,
    noise_size: int | None,
) -> Result:
    """Return the result of finished runs.

    Args:
        name: Name of the estimator.
        plan: The task.
        runs: Outcomes of the runs.
        tally: Cost of all rollouts.
        first: Robustness of the first sample.
        fresh: Counts of all rows drawn from the target.
        noise_size: Numbers a step that the user's problem reads, where they are fewer.
    """
    values = np.array([run.probability for run in runs])
    marks = _pooled_quality(runs)
    mean, checks = float(values.mean()), [run.cross_check for run in runs if run.checked]
    warnings = _health(plan, runs, marks, tally)
    variance = _relative_variance(runs, values)
    interval_at = _interval_of_weights(runs, mean, variance, marks)
    notes: tuple[Note, ...] = ()
    if mean:
        interval = interval_at(plan.confidence)
        doubts, notes = compare_checks(mean, interval, math.sqrt(variance), checks, plan.confidence)
        warnings |= doubts
        shortfall = sum(run.shortfall(mean) for run in runs) / len(runs)
        interval_at = _interval_of_weights(runs, mean, variance + shortfall, marks)
    plain = all(run.plain for run in runs)
    if plain:
        interval_at = sum((run.sample.fresh for run in runs), FreshRows()).interval
    elif not mean:
        interval_at = fresh.interval_of_zero()
    return build_result(
        plan,
        name,
        tally,
        values,
        interval_at=interval_at,
        relative_error=math.sqrt(variance),
        health=warnings,
        failures=_failures(plan, runs, tally, noise_size),
        worst=_find_worst(plan, runs, noise_size),
        robustness=first if first is not None else np.zeros(0),
        fresh=None if plain else fresh,
        blind_bound=fresh.blind_bound(plan.confidence),
        notes=notes,
        diagnostics=_diagnostics(runs, marks),
    )


def _pooled_quality(runs: Sequence[RunOutcome]) -> Quality:
    """Return the quality of the weights of all runs together; the target's rows first, as in each run."""

    def target_first(values: Callable[[RunOutcome], Floats]) -> Floats:
        target = [values(run)[: run.sample.target_rows] for run in runs]
        return np.concatenate([*target, *(values(run)[run.sample.target_rows :] for run in runs)])

    weights = target_first(lambda run: run.weights)
    failing = target_first(lambda run: run.contributions) > 0.0
    marks = quality(weights, failing, sum(run.sample.target_rows for run in runs))
    if not any(run.counted for run in runs):
        return marks
    terms = np.concatenate(
        [share / len(part.error) * failing_weights(part) for run in runs for share, part in run.parts]
    )
    total = float(terms.sum())
    largest = float(terms.max()) / total if total > 0.0 else 0.0
    return replace(marks, effective_failures=effective_size(terms), largest_share=largest)


def _health(plan: Plan, runs: Sequence[RunOutcome], marks: Quality, tally: Info) -> dict[str, str]:
    warnings: dict[str, str] = {}
    if not all(run.plain for run in runs):
        warnings = health.check_weights(
            marks.mean, marks.standard_error, marks.effective_failures, marks.largest_share
        )
    if any(run.unreached for run in runs):
        stages = max(len(run.stages) for run in runs)
        warnings |= health.warn(
            "unchecked", reason=f"the elite has not reached failure after {stages} stages"
        )
    if all(run.sample.violated.all() for run in runs):
        warnings |= health.warn("all_failed")
    return warnings | health.check_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)


def _relative_variance(runs: Sequence[RunOutcome], values: Floats) -> float:
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    # Divided first: the square of a tiny estimate is 0.
    within = sum(run.variance(mean) for run in runs) / len(runs) ** 2
    spread = float((values / mean).var(ddof=1)) / len(runs) if len(runs) > 1 else within
    return spread or within


def _interval_of_weights(
    runs: Sequence[RunOutcome], mean: float, variance: float, marks: Quality
) -> Callable[[float], Interval]:
    errors = float(np.mean([run.error_weight for run in runs]))
    freedom = len(runs) - 1 if len(runs) > 1 else max(1, int(marks.effective_failures) - 1)
    return partial(intervals.log_normal, mean, variance, freedom=freedom, errors=errors)


def _diagnostics(runs: Sequence[RunOutcome], marks: Quality) -> dict[str, object]:
    entries: dict[str, Any] = {
        "mean_weight": marks.mean,
        "mean_weight_error": marks.standard_error,
        "effective_size": marks.effective,
        "effective_failures": marks.effective_failures,
        "largest_share": marks.largest_share,
        "second_look": [None if run.cross_check is None else vars(run.cross_check) for run in runs],
        "target_rows": [run.sample.target_rows for run in runs],
        "rows": [len(run.sample.error) for run in runs],
        "check_rollouts": sum(run.cross_check.rollouts for run in runs if run.cross_check is not None),
    }
    if any(run.counted for run in runs):
        entries["shares"] = [[round(share, 4) for share, _ in run.parts] for run in runs]
    if any(run.stages for run in runs):
        entries["stages"] = [list(run.stages) for run in runs]
    return entries


def _replayable(run: RunOutcome, chosen: Bools) -> Integers:
    rows = np.flatnonzero(chosen)
    return rows if run.sample.source.replayable else rows[rows < run.sample.target_rows]


def _failures(plan: Plan, runs: Sequence[RunOutcome], tally: Info, noise_size: int | None) -> Failures:
    failing = [_replayable(run, run.sample.violated) for run in runs]
    run_of = np.repeat(np.arange(len(runs)), [len(rows) for rows in failing])
    chosen = spread(np.arange(len(run_of)), plan.kept_failures)
    kept_rows = [np.concatenate(failing)[chosen[run_of[chosen] == r]] for r in range(len(runs))]
    pairs = list(zip(runs, kept_rows, strict=True))
    # Where only the target's rows can be drawn again, those alone are a sample of failures: of equal weights.
    weighted = all(run.sample.source.replayable for run in runs)
    weights = np.concatenate(
        [run.contributions[rows] if weighted else np.ones(len(rows)) for run, rows in pairs]
    )
    if weights.any():
        weights *= float(np.mean([run.probability for run in runs])) / weights.sum()
    return Failures(
        np.concatenate([run.sample.tapes(rows)[..., :noise_size] for run, rows in pairs]),
        np.concatenate([run.sample.robustness[rows] for run, rows in pairs]),
        tally.failures,
        None if all(run.plain for run in runs) else weights,
    )


def _find_worst(plan: Plan, runs: Sequence[RunOutcome], noise_size: int | None) -> Worst:
    missing = represent_errors(plan)
    worst = Worst(missing.noise[:, :noise_size], missing.robustness)
    for run in runs:
        rows = _replayable(run, ~run.sample.error)
        if not len(rows):
            continue
        row = rows[[int(np.argmin(run.sample.robustness[rows]))]]
        least = float(run.sample.robustness[row[0]])
        if not least >= worst.robustness:
            worst = Worst(run.sample.tapes(row)[0][:, :noise_size], least)
    return worst
