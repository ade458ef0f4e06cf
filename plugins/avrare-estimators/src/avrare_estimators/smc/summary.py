"""Summary of the runs of ``smc``: mean, interval and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.estimation.checks.result_builder import build_result, represent_errors
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result import intervals
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Failures, Result, Worst, spread
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common import health
from avrare_estimators.common.learning.stage_agreement import find_differing
from avrare_estimators.common.looks import Looks
from avrare_estimators.common.weights import effective_size, resample
from avrare_estimators.smc.learning import Learning
from avrare_estimators.smc.particles import Course, Ends, Particles, draw_tapes

_PLAIN = Note(
    "learning",
    "Nothing was learnt that separates failures from other rollouts: the particles are independent "
    "rollouts of the target, which is Monte Carlo.",
)


@dataclass(frozen=True)
class Counted:
    """Numbers that a result needs of R runs that have ended.

    Attributes:
        course: What the runs share.
        first_run: Address of the first run's noise.
        probabilities: (R,) unbiased except for the cut at 1.
        errors: (R,) weight of the particles that broke down.
        roots: (R,) first particles with failing descendants.
        contributions: Of these first particles, in all runs.
        plain: The particles are independent rollouts of the target.
        rows: R N.
        failing: Some failures of each run, with the weights of all.
        worst: The least robust particle, or none.
    """

    course: Course
    first_run: int
    probabilities: Floats
    errors: Floats
    roots: Integers
    contributions: Floats
    plain: bool
    rows: int
    failing: Ends
    worst: Ends

    @property
    def fresh(self) -> FreshRows:
        """Counts of independent rollouts of the target."""
        size = self.course.particles
        failures, errors = (round(float(share.sum()) * size) for share in (self.probabilities, self.errors))
        return FreshRows(self.rows, failures, errors)

    @staticmethod
    def of(particles: Particles) -> Counted:
        """Sum up runs that have ended."""
        ends, runs, course = particles.list_ended_particles(), particles.runs, particles.course
        run, weight = ends.rows.run, ends.rows.weight

        def by_run(chosen: Any) -> Floats:
            return np.asarray(np.bincount(run, np.where(chosen, weight, 0.0), runs), dtype=np.float64)

        size = course.particles
        failing_weight = np.where(ends.violated, weight, 0.0)
        sums = np.asarray(np.bincount(ends.rows.root, failing_weight, runs * size), dtype=np.float64)
        by_root = sums.reshape(runs, size)
        alive = np.flatnonzero(~ends.error)
        least = alive[np.argsort(ends.robustness[alive], kind="stable")[:1]]
        return Counted(
            course,
            particles.first_run,
            np.minimum(1.0, by_run(ends.violated)),
            by_run(ends.error),
            (by_root > 0.0).sum(axis=1),
            by_root[by_root > 0.0],
            course.law is None and not any(particles.resampled),
            runs * size,
            _some_failures(ends, runs),
            batch.take(ends, least),
        )


def _some_failures(ends: Ends, runs: int) -> Ends:
    """Return a limited number of failures of each run, so that batches give the same."""
    chosen, weights = [np.zeros(0, np.int64)], [np.zeros(0)]
    most_kept = 40  # failures of each run that are kept
    for run in range(runs):
        rows = np.flatnonzero(ends.violated & (ends.rows.run == run))
        weight = ends.rows.weight[rows]
        if len(rows) > most_kept:
            drawn, copies = np.unique(resample(weight, most_kept, 0.5), return_counts=True)
            rows, weight = rows[drawn], copies * weight.sum() / most_kept
        chosen.append(rows)
        weights.append(weight)
    failures = batch.take(ends, np.concatenate(chosen))
    return replace(failures, rows=replace(failures.rows, weight=np.concatenate(weights)))


def summarise(
    name: str,
    plan: Plan,
    learning: Learning,
    counted: Sequence[Counted],
    looks: Looks,
    tally: Info,
) -> Result:
    """Return the result of runs that have ended.

    Args:
        name: Name of the estimator.
        plan: The task.
        learning: Learning that went before.
        counted: The runs.
        looks: Numbers of runs at which the estimate could end.
        tally: Cost of all rollouts.
    """
    values = _concatenate(counted, "probabilities")
    mean, runs = float(values.mean()), len(values)
    contributions, roots = _concatenate(counted, "contributions"), _concatenate(counted, "roots")
    relative = _relative_variance(values, contributions)
    # One resampled run suffices: its particles are not independent, whichever batch it advanced with.
    plain = all(runs_of_batch.plain for runs_of_batch in counted)
    own_fresh = sum((runs_of_batch.fresh for runs_of_batch in counted), FreshRows())
    samples = learning.pool.samples
    fresh = sum((sample.fresh for sample in samples), plan.seen)
    if plain:
        fresh = fresh + own_fresh
    interval_at = looks.interval(
        runs, own_fresh.interval if plain else _interval(counted, values, relative, fresh)
    )
    warnings = _health(plan, plain, values, contributions, roots, tally)
    if mean > 0.0 and not plain:
        warnings |= find_differing(samples, mean, relative)
    diagnostics = _diagnostics(counted, learning) | looks.diagnostics(math.sqrt(relative))
    notes = (*looks.notes(tally.rollouts, mean, math.sqrt(relative)), *((_PLAIN,) if plain else ()))
    return build_result(
        plan,
        name,
        tally,
        values,
        interval_at=interval_at,
        relative_error=math.sqrt(relative),
        health=warnings,
        failures=_failures(plan, counted, mean, plain, tally),
        worst=_find_worst(plan, counted),
        robustness=np.where(samples[0].error, np.nan, samples[0].robustness),
        fresh=None if plain else fresh,
        blind_bound=fresh.blind_bound(plan.confidence),
        notes=notes,
        diagnostics=diagnostics,
    )


def _diagnostics(counted: Sequence[Counted], learning: Learning) -> dict[str, object]:
    contributions = _concatenate(counted, "contributions")
    return {
        "particles": counted[0].course.particles,
        "resampled_at": [counted[0].course.ends[k] for k in range(len(counted[0].course.stops))],
        "roots": _concatenate(counted, "roots").tolist(),
        "effective_failures": effective_size(contributions),
        "largest_share": float(contributions.max(initial=0.0) / max(contributions.sum(), 1e-300)),
        "pilot_rollouts": sum(stage["rollouts"] for stage in learning.stages),
        "stages": list(learning.stages),
    }


def _concatenate(counted: Sequence[Counted], name: str) -> Any:
    return np.concatenate([getattr(runs, name) for runs in counted])


def _relative_variance(values: Floats, contributions: Floats) -> float:
    """Return the relative variance of the mean of the runs; NaN where all are zero."""
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    within = 1.0 / effective_size(contributions)
    return float((values / mean).var(ddof=1)) / len(values) or within if len(values) > 1 else within


def _interval(
    counted: Sequence[Counted], values: Floats, relative: float, fresh: FreshRows
) -> Callable[[float], Interval]:
    if not values.any():
        return fresh.interval_of_zero()
    return partial(
        intervals.log_normal,
        float(values.mean()),
        relative,
        freedom=len(values) - 1,
        errors=float(_concatenate(counted, "errors").mean()),
        logs=intervals.cox(values),
    )


def _health(
    plan: Plan,
    plain: bool,
    values: Floats,
    contributions: Floats,
    roots: Integers,
    tally: Info,
) -> dict[str, str]:
    warnings = health.check_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if float(values.mean()) == 1.0:
        warnings |= health.warn("all_failed")
    if plain:
        return warnings
    if not values.any():
        return warnings | health.warn("no_failures")
    warnings |= health.check_runs(values.tolist(), roots.tolist())
    effective, largest = effective_size(contributions), float(contributions.max() / contributions.sum())
    if effective < health.LEAST_EFFECTIVE or largest > health.LARGEST_SHARE:
        warnings |= health.warn("weight_degenerate", reason=health.describe_uneven(effective, largest))
    return warnings


def _failures(plan: Plan, counted: Sequence[Counted], mean: float, plain: bool, tally: Info) -> Failures:
    total = sum(len(runs.failing.robustness) for runs in counted)
    parts = _choose_failures(counted, spread(np.arange(total), plan.kept_failures))
    tapes = [draw_tapes(runs.course, runs.first_run, ends.rows) for runs, ends in parts]
    robustness = np.concatenate([ends.robustness for _, ends in parts])
    if plain:  # independent, of equal weights
        return Failures(np.concatenate(tapes), robustness, tally.failures)
    weights = np.concatenate([ends.rows.weight for _, ends in parts])
    if weights.any():
        weights *= mean / weights.sum()
    ancestors = [
        np.stack([ends.rows.run + runs.first_run, ends.rows.root % runs.course.particles], axis=1)
        for runs, ends in parts
    ]
    return Failures(np.concatenate(tapes), robustness, tally.failures, weights, np.concatenate(ancestors))


def _choose_failures(counted: Sequence[Counted], rows: Integers) -> list[tuple[Counted, Ends]]:
    """Return some of the failures, ``rows`` of those of all runs, ascending."""
    parts, begin = [], 0
    for runs in counted:
        end = begin + len(runs.failing.robustness)
        places = rows[(rows >= begin) & (rows < end)] - begin
        parts.append((runs, batch.take(runs.failing, places)))
        begin = end
    return parts


def _find_worst(plan: Plan, counted: Sequence[Counted]) -> Worst:
    alive = [runs for runs in counted if len(runs.worst.robustness)]
    if not alive:
        return represent_errors(plan)
    least = min(alive, key=lambda runs: float(runs.worst.robustness[0]))
    tape = draw_tapes(least.course, least.first_run, least.worst.rows)[0]
    return Worst(tape, float(least.worst.robustness[0]))
