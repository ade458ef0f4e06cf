"""Summary of finished passes through the levels: mean, interval, diagnostics and health."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from avrare.estimation.checks.result_builder import build_result
from avrare.estimation.result import intervals
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Failures, Result
from avrare.protocols import Floats
from avrare_estimators.common import health
from avrare_estimators.common.chains.kernel import Kernel
from avrare_estimators.common.chains.level_pass import LevelPass
from avrare_estimators.common.chains.levels import r_hat
from avrare_estimators.common.looks import Looks
from avrare_estimators.common.weights import effective_size
from avrare_estimators.ess.state import EssState


def summarise(name: str, kernel: Kernel, state: EssState, declared: Mapping[str, str], grows: bool) -> Result:
    """Return the result of runs that have all ended; ``declared`` are the system's warnings."""
    plan, last, tally = state.plan, state.level_pass, state.tally
    drawn = FreshRows() if last.weighted else state.fresh  # weighted rows do not come from the target
    fresh = plan.seen + drawn
    values = last.probabilities
    looks = state.looks or Looks((len(values),))
    probability = float(values.mean())
    relative_variance = _relative_variance(last, values)
    roots = _count_ancestors(last)
    warnings = health.check_runs(values.tolist(), roots)
    warnings |= health.check_errors(tally.errors, tally.rollouts, plan.max_error_rate, tally.messages)
    if probability == 1.0:
        warnings |= health.warn("all_failed")
    if kernel.note:
        warnings |= health.warn("heuristic_kernel", note=kernel.note)
    warnings |= {**kernel.warnings(last.tuning), **_weight_warnings(last), **declared}
    interval_at = _interval(last, fresh, values, relative_variance)
    if "few_roots" in warnings:
        interval_at = health.allow_for_roots(interval_at, probability, sum(roots), last.failed.size)
    interval_at = looks.interval(len(values), interval_at)
    return build_result(
        plan,
        name,
        tally,
        values,
        interval_at=interval_at,
        relative_error=math.sqrt(relative_variance),
        health=warnings,
        failures=_scale_weights(state.failures, probability),
        worst=state.worst,
        robustness=state.first,
        fresh=fresh,
        blind_bound=looks.interval(len(values), fresh.interval)(plan.confidence)[1],
        diagnostics={
            "kernel": kernel.name,
            "levels": _values_per_run(last, "level"),
            "shares": _values_per_run(last, "share"),
            "effective_sizes": _values_per_run(last, "effective"),
            "samples": last.shape.samples,
            "pilot_rollouts": state.pilot_rollouts,
            "extinct_runs": int((values == 0.0).sum()),
            "roots": roots,
            "r_hat": r_hat(_ranks_by_chain(last)).tolist(),
            "chain_variance": (_variance_over_levels(last) * values**2).tolist(),
        }
        | (
            {
                "weight_sizes": _values_per_run(last, "weight_size"),
                "largest_weights": _values_per_run(last, "largest_weight"),
            }
            if last.weighted
            else {}
        )
        | (state.pilot.diagnostics(last.shape.chains, "chains") if state.pilot and grows else {})
        | looks.diagnostics(math.sqrt(relative_variance)),
        notes=(
            *looks.notes(tally.rollouts, probability, math.sqrt(relative_variance)),
            *(state.pilot.notes(last.shape.chains, "chains") if state.pilot and grows else ()),
        ),
    )


def _scale_weights(failures: Failures, probability: float) -> Failures:
    # The weights are of runs in turn; together they add up to the estimate.
    total = 0.0 if failures.weights is None else float(failures.weights.sum())
    if failures.weights is None or total == 0.0:
        return failures
    return replace(failures, weights=failures.weights * (probability / total))


def _count_ancestors(last: LevelPass) -> list[int]:
    roots = last.points.root.reshape(last.failed.shape)
    return [len(np.unique(root[failed])) for root, failed in zip(roots, last.failed, strict=True)]


def _relative_variance(last: LevelPass, values: Floats) -> float:
    mean = float(values.mean())
    if mean == 0.0:
        return math.nan
    runs = len(values)
    ideal = abs(math.log(mean)) / (last.shape.samples * runs)
    if runs == 1:
        return float(_variance_over_levels(last)[0]) or ideal
    # Divided first: the square of a tiny estimate is 0. Runs may be equal by chance.
    return float((values / mean).var(ddof=1)) / runs or ideal


def _variance_over_levels(last: LevelPass) -> Floats:
    # Added up over the levels of a run, as if they were independent.
    shares = [(record.share, record.effective) for record in last.levels]
    total = np.zeros(last.shape.runs)
    for share, effective in [*shares, _share_of_failures(last)]:
        passed = np.isfinite(share) & (share > 0.0)
        variance = (1.0 - share) / np.where(passed, share * effective, 1.0)
        total += np.where(passed, variance, 0.0)
    return total


def _share_of_failures(last: LevelPass) -> tuple[Floats, Floats]:
    share, effective = (last.weights * last.failed).mean(axis=1), last.effective(last.failed)
    passed = np.sum([record.passed for record in last.levels], axis=0) if last.levels else 0
    fresh = np.equal(passed, 0) & (not last.weighted)
    return share, np.where(fresh, float(last.shape.samples), effective)


def _weight_warnings(last: LevelPass) -> dict[str, str]:
    if not last.weighted:
        return {}
    sizes, shares = [], []
    for run, row in enumerate(last.weights * last.failed):
        if row.any():
            passed = [record for record in last.levels if record.passed[run]]
            sizes.append(min(effective_size(row), *(float(r.weight_size[run]) for r in passed), np.inf))
            largest = (float(r.largest_weight[run]) for r in passed)
            shares.append(max(float(row.max() / row.sum()), *largest, 0.0))
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


def _interval(
    last: LevelPass, fresh: FreshRows, values: Floats, relative_variance: float
) -> Callable[[float], Interval]:
    if not values.any():
        return fresh.interval_of_zero()
    error_weight = float(last.error_weight.mean())
    if not last.levels and not last.weighted:  # no level was needed: plain Monte Carlo
        failed, trials = int(last.points.violated.sum()), len(last.points.score)
        return partial(intervals.clopper_pearson, failed, trials, errors=round(error_weight * trials))
    return partial(
        intervals.log_normal,
        float(values.mean()),
        relative_variance,
        freedom=len(values) - 1,
        errors=error_weight,
        logs=intervals.cox(values),
    )


def _values_per_run(last: LevelPass, name: str) -> list[list[float]]:
    runs = range(last.shape.runs)
    return [[float(getattr(record, name)[r]) for record in last.levels if record.passed[r]] for r in runs]


def _ranks_by_chain(last: LevelPass) -> Floats:
    # Ranks of the scores in their run have a variance for any scores.
    key = last.points.key.reshape(last.shape.runs, -1)
    order = np.argsort(np.argsort(key, axis=1, kind="stable"), axis=1, kind="stable")
    return np.asarray(last.by_chain(order.astype(np.float64)))
