"""From finished splitting runs to a result: mean, interval, genealogy and health."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from avrare import batch
from avrare.estimation import health, intervals
from avrare.estimation.montecarlo import FAILURE_LIMIT
from avrare.estimation.result import Failures, Interval, Result, Worst
from avrare.protocols import Bools, Floats
from avrare_estimators.config import AmsConfig
from avrare_estimators.population import Tapes

if TYPE_CHECKING:
    from avrare_estimators.splitting import AmsState

_STATIC = (
    "without steps there is nothing to branch from: splitting is Monte Carlo here, and runs that saw no "
    "failure count as 0; use ess"
)


def summarise(name: str, config: AmsConfig, state: AmsState) -> Result:
    """The result of runs that have all ended."""
    plan, population, tally = state.plan, state.population, state.tally
    violated = population.violated.reshape(state.runs, -1)
    values = state.probabilities
    probability = float(values.mean())
    roots = [_roots(state, r) for r in range(state.runs)]
    extinct = int((values == 0.0).sum())
    warnings = health.of_runs(values.tolist(), extinct, roots)
    if plan.steps == 0:  # more particles or fewer discards are no cure
        warnings |= {name: _STATIC for name in ("extinct", "extinct_runs") if name in warnings}
    killed = [count for levels in state.levels for _, count in levels]
    warnings |= health.of_ties(killed, config.discard, config.particles)
    warnings |= health.of_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if probability == 1.0:
        warnings |= health.warn("all_failed")
    variance = _variances(state, values, violated)
    relative_variance = _relative_variance(values, variance, config.particles)
    return Result(
        specification=plan.names[0],
        estimator=name,
        probability=probability,
        interval_at=_bounds(state, values, violated, relative_variance),
        confidence=plan.confidence,
        run_probabilities=values,
        relative_error=math.sqrt(relative_variance),
        rollouts=tally.rollouts,
        simulated_steps=tally.steps,
        errors=tally.errors,
        health=warnings,
        failures=_failures(state, config.particles),
        worst=_worst(state, config.particles),
        robustness=state.first,
        counts=dict(tally.counts),
        relation="violated" if config.variant == "unbiased" else "robustness <= 0",
        diagnostics={
            "full_rollouts": violated.size,
            "branched_rollouts": tally.rollouts - violated.size,
            "stages": [len(levels) for levels in state.levels],
            "levels": [[level for level, _ in levels] for levels in state.levels],
            "discarded": [[killed for _, killed in levels] for levels in state.levels],
            "extinct_runs": extinct,
            "roots": roots,
            "genealogical_variance": variance.tolist(),
        },
    )


def interval_of_runs(values: Floats, particles: int) -> Callable[[float], Interval]:
    """The interval of runs that needed levels and met no errors, as a function of the confidence.

    Args:
        values: (runs,) at least two.
        particles: Of each run.
    """
    if not values.any():
        return intervals.unknown
    relative = _relative_variance(values, np.zeros(1), particles)
    return partial(intervals.log_normal, float(values.mean()), relative, freedom=len(values) - 1)


def _roots(state: AmsState, run: int) -> int:
    """How many first particles the final population of a run descends from."""
    particles = len(state.population.root) // state.runs
    return len(np.unique(state.population.root[run * particles : (run + 1) * particles]))


def _variances(state: AmsState, values: Floats, violated: Bools) -> Floats:
    """(R,) variance of each run from its genealogy (Lee and Whiteley 2018, survivors kept).

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


def _relative_variance(values: Floats, variance: Floats, particles: int) -> float:
    """Of the mean, from the spread of the runs or the genealogy of a single one; NaN where all are zero."""
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    runs = len(values)
    spread = float(values.var(ddof=1)) / runs if runs > 1 else float(variance[0])
    # Runs may be equal by chance, and the unbiased estimate may fall below zero: then the least that
    # splitting can have.
    return spread / mean**2 if spread > 0.0 else -math.log(mean) / (particles * runs)


def _bounds(
    state: AmsState, values: Floats, violated: Bools, relative_variance: float
) -> Callable[[float], Interval]:
    """The interval as a function of the confidence."""
    errors = state.population.error.reshape(violated.shape)
    if not values.any():
        return intervals.unknown
    if not any(state.levels):  # no level was needed: plain Monte Carlo
        return partial(
            intervals.clopper_pearson, int(violated.sum()), violated.size, undecided=int(errors.sum())
        )
    return partial(
        intervals.log_normal,
        float(values.mean()),
        relative_variance,
        freedom=state.runs - 1,
        undecided=float((state.undecided + state.weight * errors.mean(axis=1)).mean()),
    )


def _failures(state: AmsState, particles: int) -> Failures:
    slots = np.flatnonzero(state.population.violated)[:FAILURE_LIMIT]
    tapes = batch.concatenate([state.population.tapes(slots, particles), *state.lost])
    tapes = batch.take(tapes, slice(0, FAILURE_LIMIT))
    return Failures(_noise(state, tapes), tapes.robustness, state.tally.failures)


def _worst(state: AmsState, particles: int) -> Worst:
    slots = np.flatnonzero(~state.population.error)
    tapes = batch.concatenate([state.population.tapes(slots, particles), *state.lost])
    if not len(tapes.robustness):
        return Worst(np.zeros((state.plan.steps + 1, state.plan.noise.noise_size)), math.nan)
    least = int(np.argmin(tapes.robustness))
    noise = _noise(state, batch.take(tapes, slice(least, least + 1)))
    return Worst(noise[0], float(tapes.robustness[least]))


def _noise(state: AmsState, tapes: Tapes) -> Floats:
    """Noise (F, steps + 1, noise_size), drawn again."""
    return state.plan.noise.normals(tapes.run, tapes.stage, tapes.particle, np.arange(state.plan.steps + 1))
