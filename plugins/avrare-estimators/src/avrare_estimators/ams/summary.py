"""Summary of finished splitting runs: mean, interval, genealogy and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from statistics import median

import numpy as np

from avrare.base import batch
from avrare.estimation.checks.result_builder import build_result, represent_errors
from avrare.estimation.result import intervals
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import Failures, Result, Worst
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.ams.population import TapeAddresses
from avrare_estimators.ams.state import AmsState, EndedRuns
from avrare_estimators.common import health
from avrare_estimators.common.in_turn import take_in_turn
from avrare_estimators.common.looks import Looks

_MOST_TIES = 2.0
"""Ratio of discarded to requested particles, median over the levels."""


def summarise(name: str, config: AmsConfig, state: AmsState) -> Result:
    """Return the result of runs that have all ended."""
    plan, tally, ended = state.plan, state.tally, state.finish()
    looks, pilot = state.looks or Looks((ended.runs,)), state.pilot
    fresh = plan.seen + state.fresh
    before = pilot.rollouts if pilot else 0
    violated, values = ended.violated, ended.probabilities
    probability = float(values.mean())
    roots = _count_roots(ended, values)
    warnings = health.check_runs(values.tolist(), roots)
    if plan.steps == 0:  # more particles or fewer discards are no cure
        static = (
            "without steps there is nothing to branch from: splitting is Monte Carlo here, and runs that saw "
            "no failure count as 0; use ess"
        )
        warnings |= {name: static for name in ("extinct", "few_roots") if name in warnings}
    discarded = [[count for _, count in levels] for levels in ended.levels]
    warnings |= health.check_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if probability == 1.0:
        warnings |= health.warn("all_failed")
    if any(ended.levels) and state.leaps.too_many:
        warnings |= health.warn("leaps", share=state.leaps.share)
    variance = _variances(ended, values)
    relative = relative_variance(values, variance, state.particles)
    interval_at = _interval(ended, values, fresh, relative)
    if "few_roots" in warnings:
        interval_at = health.allow_for_roots(interval_at, probability, sum(roots), violated.size)
    interval_at = looks.interval(ended.runs, interval_at)
    return build_result(
        plan,
        name,
        tally,
        values,
        interval_at=interval_at,
        relative_error=math.sqrt(relative),
        health=warnings,
        failures=_failures(state, ended),
        worst=_find_worst(state, ended),
        robustness=state.first,
        fresh=fresh,
        blind_bound=looks.interval(ended.runs, fresh.interval)(plan.confidence)[1],
        relation="violated" if config.variant == "unbiased" else "robustness <= 0",
        diagnostics={
            "full_rollouts": violated.size,
            "branched_rollouts": tally.rollouts - violated.size - before,
            "stages": [len(levels) for levels in ended.levels],
            "levels": [[level for level, _ in levels] for levels in ended.levels],
            "discarded": discarded,
            "extinct_runs": int((values == 0.0).sum()),
            "roots": roots,
            "genealogical_variance": variance.tolist(),
        }
        | ({"saved_steps": state.saved} if config.early_stop else {})
        | (pilot.diagnostics(state.particles, "particles") if pilot else {})
        | looks.diagnostics(math.sqrt(relative)),
        notes=(
            *looks.notes(tally.rollouts, probability, math.sqrt(relative)),
            *(pilot.notes(state.particles, "particles") if pilot else ()),
            *_describe_ties(discarded, config.discard * state.growth, state.particles),
        ),
    )


def _count_roots(ended: EndedRuns, values: Floats) -> list[int]:
    """Return how many first particles each run's failures (without any: its particles) descend from."""
    rows = zip(ended.root, ended.violated, values, strict=True)
    return [
        len(np.unique(root[failed] if failed.any() else root)) if value else 0 for root, failed, value in rows
    ]


def _describe_ties(discarded: Sequence[Sequence[int]], discard: int, particles: int) -> tuple[Note, ...]:
    """Return the note on runs most of whose levels discard many more particles than ``discard``."""
    counts = [count for run in discarded for count in run]
    if not counts or (typical := median(counts)) <= _MOST_TIES * discard:
        return ()
    text = (
        f"Half of the levels discarded more than {typical / particles:.0%} of the particles instead of "
        f"{discard}: the score takes few values, and runs scatter the more."
    )
    return (Note("ties", text),)


def relative_variance(values: Floats, variance: Floats, particles: int) -> float:
    """Return the relative variance of the mean; NaN where all runs are zero.

    It comes from the spread of the runs, or from the genealogy of a single one. Runs may be equal by chance,
    and the genealogical estimate may fall below zero: the answer is then the least that splitting can have.

    Args:
        values: (runs,) probabilities.
        variance: (runs,) genealogical variances; only that of a single run is used.
        particles: Number of particles of a run.
    """
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    runs = len(values)
    spread = float(values.var(ddof=1)) / runs if runs > 1 else float(variance[0])
    return spread / mean**2 if spread > 0.0 else -math.log(mean) / (particles * runs)


def _variances(ended: EndedRuns, values: Floats) -> Floats:
    """Return the variance (R,) of each run from its genealogy (Lee and Whiteley 2018, survivors kept).

    Unbiased where no failure was discarded; else those are taken to scatter as the others do.
    """
    variances = np.empty(ended.runs)
    for r, violated in enumerate(ended.violated):
        _, count = np.unique(ended.root[r][violated], return_counts=True)
        failed = int(count.sum())
        different = failed**2 - int((count.astype(np.int64) ** 2).sum())
        p = ended.weight[r] * failed / len(violated)
        relative = 1.0 - ended.pairs[r] * different / p**2 if failed else 1.0
        variances[r] = relative * values[r] ** 2
    return variances


def _interval(
    ended: EndedRuns, values: Floats, fresh: FreshRows, relative: float
) -> Callable[[float], Interval]:
    violated, error = ended.violated, ended.error
    if not values.any():
        return fresh.interval_of_zero()
    if not any(ended.levels):  # no level was needed: plain Monte Carlo
        return partial(intervals.clopper_pearson, int(violated.sum()), violated.size, errors=int(error.sum()))
    return partial(
        intervals.log_normal,
        float(values.mean()),
        relative,
        freedom=ended.runs - 1,
        errors=float((ended.error_weight + ended.weight * error.mean(axis=1)).mean()),
        logs=intervals.cox(values),
    )


def _failures(state: AmsState, ended: EndedRuns) -> Failures:
    alive, retired = ended.failing, ended.retired_failures
    masses = (ended.weight * ended.violated.mean(axis=1), ended.retired)
    first = state.first_run if state.ended is None else 0
    parts = [
        _divide(mass, tapes.run[:, 0] - first) for mass, tapes in zip(masses, (alive, retired), strict=True)
    ]
    run = np.concatenate([alive.run, retired.run])[:, 0]
    chosen = take_in_turn(run, state.plan.kept_failures)
    tapes, weights = batch.take(batch.concatenate([alive, retired]), chosen), np.concatenate(parts)[chosen]
    if weights.any():
        weights *= float(ended.probabilities.mean()) / weights.sum()
    ancestors = np.stack([tapes.run[:, 0], tapes.root], axis=1)
    noise = _redraw_tapes(state, tapes)
    return Failures(noise, tapes.robustness, state.tally.failures, weights, ancestors)


def _divide(mass: Floats, run: Integers) -> Floats:
    """Divide the mass (R,) of each run among its kept tapes, whose runs are ``run`` (F,)."""
    count = np.bincount(run, minlength=len(mass))
    return np.asarray(mass[run] / count[run])


def _find_worst(state: AmsState, ended: EndedRuns) -> Worst:
    if not len(ended.worst.robustness):
        return represent_errors(state.plan)
    return Worst(_redraw_tapes(state, ended.worst)[0], float(ended.worst.robustness[0]))


def _redraw_tapes(state: AmsState, tapes: TapeAddresses) -> Floats:
    return state.plan.noise.normals(tapes.run, tapes.stage, tapes.particle, np.arange(state.plan.steps + 1))
