"""From runs that have gone down to a result: mean, interval, diagnostics and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from avrare.estimation import health, intervals
from avrare.estimation.montecarlo import FAILURE_LIMIT
from avrare.estimation.result import Failures, Interval, Result
from avrare.protocols import Floats
from avrare_estimators.chains import Kernel
from avrare_estimators.descent import Descent
from avrare_estimators.ess_config import EssConfig
from avrare_estimators.nested_levels import r_hat
from avrare_estimators.weights import effective_size

if TYPE_CHECKING:
    from avrare_estimators.nested import EssState


def summarise(
    name: str, config: EssConfig, kernel: Kernel, state: EssState, notes: Mapping[str, str]
) -> Result:
    """The result of runs that have all ended; ``notes`` are warnings that the system wants on it."""
    plan, descent, tally = state.plan, state.descent, state.tally
    values = descent.probabilities
    probability = float(values.mean())
    relative_variance = _relative_variance(descent, values)
    extinct = int((values == 0.0).sum())
    warnings = health.of_runs(values.tolist(), extinct, _roots(descent))
    warnings |= health.of_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if probability == 1.0:
        warnings |= health.warn("all_failed")
    if kernel.note:
        warnings |= health.warn("heuristic_kernel", note=kernel.note)
    seen: Callable[[Any], dict[str, str]] | None = getattr(kernel, "warnings", None)
    if seen is not None:
        warnings |= seen(descent.known)
    warnings |= {**_of_weights(descent), **notes}
    return Result(
        specification=plan.names[0],
        estimator=name,
        probability=probability,
        interval_at=_bounds(state, values, relative_variance),
        confidence=plan.confidence,
        run_probabilities=values,
        relative_error=math.sqrt(relative_variance),
        rollouts=tally.rollouts,
        simulated_steps=tally.steps,
        errors=tally.errors,
        health=warnings,
        failures=_failures(descent, tally.failures),
        worst=state.worst,
        robustness=state.first,
        counts=dict(tally.counts),
        diagnostics=_diagnostics(config, state, extinct),
    )


def _roots(descent: Descent) -> list[int]:
    """First tapes that each run's failures descend from."""
    assert descent.population is not None
    shape = (descent.shape.runs, -1)
    roots, violated = descent.population.root.reshape(shape), descent.population.violated.reshape(shape)
    return [len(np.unique(roots[r][violated[r]])) for r in range(descent.shape.runs)]


def _relative_variance(descent: Descent, values: Floats) -> float:
    """Of the mean, from the spread of the runs, or of a single one from the scatter of its chains."""
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    runs = len(values)
    ideal = abs(math.log(mean)) / (descent.shape.samples * runs)
    if runs == 1:
        return float(_of_levels(descent)[0]) or ideal
    # Divided first: the square of a tiny estimate is 0. Runs may be equal by chance.
    return float((values / mean).var(ddof=1)) / runs or ideal


def _of_levels(descent: Descent) -> Floats:
    """(R,) relative variance of each run, added up over its levels as if they were independent."""
    last = _last_share(descent)
    shares = [(step.share, step.effective) for step in descent.steps] + [last]
    total = np.zeros(descent.shape.runs)
    for share, effective in shares:
        known = np.isfinite(share) & (share > 0.0)
        part = (1.0 - share) / np.where(known, share * effective, 1.0)
        total += np.where(known, part, 0.0)
    return total


def _last_share(descent: Descent) -> tuple[Floats, Floats]:
    """Share of failures in the final populations, and what it is worth."""
    assert descent.population is not None
    failed = descent.population.violated.reshape(descent.shape.runs, -1)
    share, effective = (descent.weights * failed).mean(axis=1), descent.effective(failed)
    levels = np.sum([step.going for step in descent.steps], axis=0) if descent.steps else 0
    fresh = np.equal(levels, 0) & ~_weighted(descent)
    return share, np.where(fresh, float(descent.shape.samples), effective)


def _weighted(descent: Descent) -> bool:
    """Whether the system reports weights."""
    assert descent.population is not None
    return bool(descent.population.log_weight.any())


def _of_weights(descent: Descent) -> dict[str, str]:
    """Warns where, in half of the runs, a level or the failures rest on a few samples of large weight."""
    assert descent.population is not None
    if not _weighted(descent):
        return {}
    failing = descent.weights * descent.population.violated.reshape(descent.shape.runs, -1)
    sizes, shares = [], []
    for run, row in enumerate(failing):
        if row.any():
            steps = [step for step in descent.steps if step.going[run]]
            sizes.append(min(effective_size(row), *(float(step.weights[run]) for step in steps), np.inf))
            shares.append(
                max(float(row.max() / row.sum()), *(float(step.largest[run]) for step in steps), 0.0)
            )
    if not sizes:
        return {}
    size, share = float(np.median(sizes)), float(np.median(shares))
    if size >= health.LEAST_EFFECTIVE and share <= health.LARGEST_SHARE:
        return {}
    text = (
        f"in half of the runs the weights of a level are worth {size:.1f} samples, or the largest has "
        f"{share:.0%} of them: the noise drawn is far from the one that is meant; fit it better, or use more "
        "chains"
    )
    return {"weight_degenerate": text}


def _bounds(state: EssState, values: Floats, relative_variance: float) -> Callable[[float], Interval]:
    """The interval as a function of the confidence."""
    descent = state.descent
    assert descent.population is not None
    if not values.any():
        return intervals.unknown
    if not descent.steps and not _weighted(descent):  # no level was needed: plain Monte Carlo
        failed, trials = int(descent.population.violated.sum()), len(descent.population.score)
        broken = round(float(descent.undecided.mean()) * trials)
        return partial(intervals.clopper_pearson, failed, trials, undecided=broken)
    return partial(
        intervals.log_normal, float(values.mean()), relative_variance, freedom=len(values) - 1,
        undecided=float(descent.undecided.mean()),
    )  # fmt: skip


def _failures(descent: Descent, count: int) -> Failures:
    """Different failing tapes among the final samples; a chain that stays repeats its own."""
    assert descent.population is not None
    population = descent.population
    kept: dict[bytes, int] = {}
    for row in np.flatnonzero(population.violated):
        if len(kept) == FAILURE_LIMIT:
            break
        kept.setdefault(population.tape[row].tobytes(), int(row))
    rows = np.array(list(kept.values()), dtype=np.int64)
    return Failures(population.tape[rows], population.robustness[rows], count)


def _diagnostics(config: EssConfig, state: EssState, extinct: int) -> dict[str, Any]:
    descent = state.descent
    weights = {"weight_sizes": "weights", "largest_weights": "largest"} if _weighted(descent) else {}
    return {
        "kernel": config.kernel,
        "levels": _per_run(descent, "level"),
        "shares": _per_run(descent, "share"),
        "effective_sizes": _per_run(descent, "effective"),
        "samples": descent.shape.samples,
        "pilot_rollouts": state.pilot,
        "extinct_runs": extinct,
        "roots": _roots(descent),
        "r_hat": r_hat(_ranks(descent)).tolist(),
        "chain_variance": (_of_levels(descent) * descent.probabilities**2).tolist(),
        **{name: _per_run(descent, attribute) for name, attribute in weights.items()},
    }


def _per_run(descent: Descent, name: str) -> list[list[float]]:
    """An attribute of the levels that each run went through."""
    runs = range(descent.shape.runs)
    return [[float(getattr(step, name)[r]) for step in descent.steps if step.going[r]] for r in runs]


def _ranks(descent: Descent) -> Floats:
    """(R, P, C) of the final samples in their run, by score: ranks have a variance whatever scores do."""
    assert descent.population is not None
    key = descent.population.key.reshape(descent.shape.runs, -1)
    order = np.argsort(np.argsort(key, axis=1, kind="stable"), axis=1, kind="stable")
    return np.asarray(descent.samples(order.astype(np.float64)))
