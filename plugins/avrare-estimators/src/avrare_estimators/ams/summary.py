"""Summary of finished splitting runs: mean, interval, genealogy and health."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from avrare.base import batch
from avrare.estimation import health, intervals
from avrare.estimation.result import FAILURE_LIMIT, Failures, Interval, Result, Worst
from avrare.estimation.result_builder import build_result, missing_worst
from avrare.protocols import Bools, Floats
from avrare_estimators.ams.state import AmsState, TapeAddresses
from avrare_estimators.config import AmsConfig
from avrare_estimators.looks import Looks

_STATIC = (
    "without steps there is nothing to branch from: splitting is Monte Carlo here, and runs that saw no "
    "failure count as 0; use ess"
)


def summarise(name: str, config: AmsConfig, state: AmsState) -> Result:
    """Return the result of runs that have all ended."""
    plan, population, tally = state.plan, state.population, state.tally
    looks, pilot = state.looks or Looks((state.runs,)), state.pilot
    violated = population.violated.reshape(state.runs, -1)
    values = state.probabilities
    probability = float(values.mean())
    roots = [len(np.unique(row)) for row in population.root.reshape(violated.shape)]
    extinct = int((values == 0.0).sum())
    warnings = health.check_runs(values.tolist(), extinct, roots)
    if plan.steps == 0:  # more particles or fewer discards are no cure
        warnings |= {name: _STATIC for name in ("extinct", "extinct_runs") if name in warnings}
    discarded = [[count for _, count in levels] for levels in state.levels]
    counts = [count for run in discarded for count in run]
    warnings |= health.check_ties(counts, config.discard * state.growth, state.particles)
    warnings |= health.check_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if probability == 1.0:
        warnings |= health.warn("all_failed")
    variance = _variances(state, values, violated)
    relative = relative_variance(values, variance, state.particles)
    return build_result(
        plan,
        name,
        tally,
        values,
        interval_at=looks.interval(state.runs, _interval(state, values, violated, relative)),
        relative_error=math.sqrt(relative),
        health=warnings,
        failures=_failures(state, state.particles),
        worst=_worst(state, state.particles),
        robustness=state.first,
        blind_bound=looks.interval(state.runs, state.fresh.interval)(plan.confidence)[1],
        relation="violated" if config.variant == "unbiased" else "robustness <= 0",
        diagnostics={
            "full_rollouts": violated.size,
            "branched_rollouts": tally.rollouts - violated.size - (pilot.rollouts if pilot else 0),
            "stages": [len(levels) for levels in state.levels],
            "levels": [[level for level, _ in levels] for levels in state.levels],
            "discarded": discarded,
            "extinct_runs": extinct,
            "roots": roots,
            "genealogical_variance": variance.tolist(),
        }
        | (pilot.diagnostics(state.particles, "particles") if pilot else {})
        | looks.diagnostics(math.sqrt(relative)),
    )


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


def _variances(state: AmsState, values: Floats, violated: Bools) -> Floats:
    """Return the variance (R,) of each run from its genealogy (Lee and Whiteley 2018, survivors kept).

    Unbiased where no failure was discarded; else those are taken to scatter as the others do.
    """
    roots = state.population.root.reshape(violated.shape)
    variances = np.empty(state.runs)
    for r in range(state.runs):
        _, count = np.unique(roots[r][violated[r]], return_counts=True)
        failed = int(count.sum())
        different = failed**2 - int((count.astype(np.int64) ** 2).sum())
        p = state.weight[r] * failed / violated.shape[1]
        relative = 1.0 - state.pairs[r] * different / p**2 if failed else 1.0
        variances[r] = relative * values[r] ** 2
    return variances


def _interval(
    state: AmsState, values: Floats, violated: Bools, relative: float
) -> Callable[[float], Interval]:
    errors = state.population.error.reshape(violated.shape)
    if not values.any():
        return state.fresh.interval_of_zero()
    if not any(state.levels):  # no level was needed: plain Monte Carlo
        return partial(
            intervals.clopper_pearson, int(violated.sum()), violated.size, errors=int(errors.sum())
        )
    return partial(
        intervals.log_normal,
        float(values.mean()),
        relative,
        freedom=state.runs - 1,
        errors=float((state.error_weight + state.weight * errors.mean(axis=1)).mean()),
        logs=intervals.cox(values),
    )


def _failures(state: AmsState, particles: int) -> Failures:
    slots = np.flatnonzero(state.population.violated)[:FAILURE_LIMIT]
    tapes = batch.concatenate([state.population.addresses(slots, particles), *state.discarded_failures])
    tapes = batch.take(tapes, slice(0, FAILURE_LIMIT))
    return Failures(_redraw_tapes(state, tapes), tapes.robustness, state.tally.failures)


def _worst(state: AmsState, particles: int) -> Worst:
    slots = np.flatnonzero(~state.population.error)
    tapes = batch.concatenate([state.population.addresses(slots, particles), *state.discarded_failures])
    if not len(tapes.robustness):
        return missing_worst(state.plan)
    least = int(np.argmin(tapes.robustness))
    noise = _redraw_tapes(state, batch.take(tapes, slice(least, least + 1)))
    return Worst(noise[0], float(tapes.robustness[least]))


def _redraw_tapes(state: AmsState, tapes: TapeAddresses) -> Floats:
    return state.plan.noise.normals(tapes.run, tapes.stage, tapes.particle, np.arange(state.plan.steps + 1))
