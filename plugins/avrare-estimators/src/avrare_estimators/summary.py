"""From finished splitting runs to a result: mean, interval, genealogy and health."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from avrare.estimation import health, intervals
from avrare.estimation.montecarlo import FAILURE_LIMIT
from avrare.estimation.result import Failures, Interval, Result, Worst
from avrare.protocols import Bools, Floats
from avrare_estimators.config import AmsConfig

if TYPE_CHECKING:
    from avrare_estimators.splitting import AmsState


def summarise(name: str, config: AmsConfig, state: AmsState) -> Result:
    """The result of runs that have all ended."""
    plan, population, tally = state.plan, state.population, state.tally
    violated = population.violated.reshape(state.runs, -1)
    values = state.weight * violated.mean(axis=1)
    probability = float(values.mean())
    roots = [_roots(state, r) for r in range(state.runs)]
    extinct = int((values == 0.0).sum())
    warnings = health.of_runs(values.tolist(), extinct, roots)
    warnings |= health.of_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    variance = _variances(state, violated)
    return Result(
        specification=plan.names[0],
        estimator=name,
        probability=probability,
        interval=_interval(state, values, violated, variance),
        confidence=plan.confidence,
        run_probabilities=values,
        relative_error=_relative_error(values, variance),
        rollouts=tally.rollouts,
        simulated_steps=tally.steps,
        errors=tally.errors,
        health=warnings,
        failures=_failures(state, config.particles),
        worst=_worst(state, config.particles),
        robustness=state.first,
        counts=dict(tally.counts),
        diagnostics={
            "stages": [len(levels) for levels in state.levels],
            "levels": [[level for level, _ in levels] for levels in state.levels],
            "discarded": [[killed for _, killed in levels] for levels in state.levels],
            "extinct_runs": extinct,
            "roots": roots,
            "genealogical_variance": variance.tolist(),
        },
    )


def _roots(state: AmsState, run: int) -> int:
    """How many first particles the final population of a run descends from."""
    particles = len(state.population.root) // state.runs
    return len(np.unique(state.population.root[run * particles : (run + 1) * particles]))


def _variances(state: AmsState, violated: Bools) -> Floats:
    """(R,) unbiased variance of each run from its genealogy (Lee and Whiteley 2018, survivors kept)."""
    roots = state.population.root.reshape(violated.shape)
    variances = np.empty(state.runs)
    for r in range(state.runs):
        _, count = np.unique(roots[r][violated[r]], return_counts=True)
        failed = int(count.sum())
        different = failed**2 - int((count.astype(np.int64) ** 2).sum())
        p = state.weight[r] * failed / violated.shape[1]
        variances[r] = p**2 - state.pairs[r] * different
    return variances


def _interval(state: AmsState, values: Floats, violated: Bools, variance: Floats) -> Interval:
    confidence, mean = state.plan.confidence, float(values.mean())
    errors = state.population.error.reshape(violated.shape)
    if not any(state.levels):  # no level was needed: plain Monte Carlo
        return (
            intervals.clopper_pearson(int(violated.sum()), violated.size, confidence, int(errors.sum()))
            if violated.any()
            else (0.0, 1.0)
        )
    if mean == 0.0:
        return 0.0, 1.0
    if len(values) == 1:
        relative = max(float(variance[0]) / mean**2, 0.0)
        factor = intervals.normal_quantile(0.5 + confidence / 2.0)
        low, high = intervals.log_normal(mean, relative, factor)
    else:
        low, high = intervals.of_runs(values.tolist(), confidence)
    undecided = float((state.weight * errors.mean(axis=1)).mean())
    return low, min(1.0, high + undecided)


def _relative_error(values: Floats, variance: Floats) -> float:
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    if len(values) == 1:
        return math.sqrt(max(float(variance[0]), 0.0)) / mean
    return float(values.std(ddof=1)) / math.sqrt(len(values)) / mean


def _failures(state: AmsState, particles: int) -> Failures:
    slots = np.flatnonzero(state.population.violated)[:FAILURE_LIMIT]
    return Failures(_tapes(state, slots, particles), state.population.robustness[slots], state.tally.failures)


def _worst(state: AmsState, particles: int) -> Worst:
    population = state.population
    robustness = np.where(population.error, np.nan, population.robustness)
    if np.isnan(robustness).all():
        return Worst(np.zeros((state.plan.steps + 1, state.plan.noise.noise_size)), math.nan)
    slot = int(np.nanargmin(robustness))
    return Worst(_tapes(state, np.array([slot]), particles)[0], float(robustness[slot]))


def _tapes(state: AmsState, slots: Any, particles: int) -> Any:
    """Noise (F, steps + 1, noise_size) of slots, drawn again from the addresses of their pieces."""
    population, plan, steps = state.population, state.plan, state.plan.steps + 1
    run = np.repeat(slots // particles, steps)
    stage, particle = population.stage[slots].reshape(-1), population.particle[slots].reshape(-1)
    noise = plan.noise.normals(run, stage, particle, np.tile(np.arange(steps), len(slots)))
    return noise.reshape(len(slots), steps, plan.noise.noise_size)
