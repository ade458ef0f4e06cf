"""Results: assembly from the numbers of an estimator, and the health checks that need the problem."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base.number_format import format_interval, format_probability
from avrare.estimation.checks.outlier_probe import probe_cost, probe_outliers
from avrare.estimation.checks.pair_probe import pair_probe_cost, probe_pairs
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result import health
from avrare.estimation.result.doubts import FAR_OFF, open_interval
from avrare.estimation.result.note import describe_blind_bound, describe_counts, describe_errors
from avrare.estimation.result.result import Result, Worst
from avrare.logic.syntax.nodes import bounded_span
from avrare.protocols import Floats, System, overrides
from avrare.rollout.executors.work import Executor, run_on_worker
from avrare.rollout.problem import Problem
from avrare.rollout.scores.term_sizes import PROBE_ROWS

_LOOK_SHARE = 20
"""Rollouts of an estimate over those of a look, which are not counted: it costs 5 % at most."""
_REPLAY, _SEARCH = "the replay of the least robust rollout", "the search for failures that were missed"


def build_result(
    plan: Plan, estimator: str, total: Info, run_probabilities: Floats, column: int = 0, **fields: Any
) -> Result:
    """Build the result of specification number ``column``; ``fields`` are further ones of ``Result``."""
    notes = fields.pop("notes", ())
    if "errors" not in fields.get("health", {}):
        notes = (*notes, *describe_errors(total.errors, total.rollouts, total.messages))
    return Result(
        specification=plan.names[column],
        estimator=estimator,
        probability=float(run_probabilities.mean()),
        confidence=plan.confidence,
        run_probabilities=run_probabilities,
        rollouts=total.rollouts,
        shared_by=len(plan.names),
        simulated_steps=total.steps,
        errors=total.errors,
        counts=dict(total.counts),
        notes=notes,
        **fields,
    )


def add_counts(result: Result, counts: Iterable[Mapping[str, int]]) -> Result:
    """Return a result whose counters include those of other parts of its estimate."""
    total = dict(sorted(sum(map(Counter, counts), Counter(result.counts)).items()))
    others = [note for note in result.notes if note.kind != "counts"]
    return replace(result, counts=total, notes=(*others, *describe_counts(total)))


def represent_errors(plan: Plan) -> Worst:
    """Return the least robust rollout of an estimate in which every rollout ended in an error."""
    return Worst(np.zeros((plan.steps + 1, plan.noise.noise_size)), math.nan)


def examine(
    problem: Problem,
    results: Sequence[Result],
    warnings: Mapping[str, str],
    executor: Executor,
    *,
    replay: bool,
    suppress: Collection[str],
    seed: int,
) -> list[Result]:
    """Add the warnings that need the problem, and the notes on bound and counters, to the results.

    ``warnings`` are those of checks of the system; those that it declares come with them. ``replay``:
    run the least robust rollouts again on the executor, which is open, and compare, unless the system is
    known not to be deterministic.
    """
    on_system = {**warnings, **problem.system.warnings}
    again: Sequence[float] = ()
    if replay and "not_deterministic" not in on_system:
        tapes = [result.worst.noise for result in results]
        again = run_on_worker(executor, _REPLAY, _replay_tapes, tapes)
    complete = []
    for column, result in enumerate(results):
        findings = {**result.health, **on_system, **_horizon(problem, column), **_solver(result.counts)}
        findings |= contradict(result)
        least_upper = 0.0
        if result.blind_bound is not None and result.blind_bound > FAR_OFF * result.interval[1]:
            flat = _flat_part(executor, column, result)
            outliers, least_upper = ({}, 0.0) if flat else _outliers(executor, problem, column, result, seed)
            findings |= flat | outliers
        if again and "not_deterministic" not in findings:
            findings |= _reproduction(executor, result, column, again[column], rounds="rounding" in findings)
        reported = {name: text for name, text in findings.items() if name not in suppress}
        notes = (*result.notes, *describe_blind_bound(result.blind_bound), *describe_counts(result.counts))
        result = open_interval(result, findings, least_upper)
        complete.append(replace(result, health=reported, notes=notes))
    return complete


def contradict(result: Result) -> dict[str, str]:
    """Return the warning that rollouts of the target, which see every failure, contradict a result."""
    fresh = result.fresh
    if fresh is None or not (fresh.rows and result.probability):
        return {}
    counted, interval = fresh.interval(result.confidence), result.interval
    if interval[0] <= counted[1] and counted[0] <= interval[1]:
        return {}
    counts = f"{fresh.failures} of {fresh.rows} rollouts of the target failed"
    estimate = f"{format_probability(result.probability)} ({format_interval(interval)})"
    reason = f"{counts}, a probability of {format_interval(counted)}, but the estimate is {estimate}"
    return health.warn("contradicted", reason=reason)


def _horizon(problem: Problem, column: int) -> dict[str, str]:
    formula = problem.monitors[column].formula
    span = bounded_span(formula.node) if formula is not None else 0
    if span <= problem.steps:
        return {}
    return health.warn("horizon_short", horizon=span, steps=problem.steps)


def _flat_part(executor: Executor, column: int, result: Result) -> dict[str, str]:
    if result.rollouts < _LOOK_SHARE * PROBE_ROWS:
        return {}
    parts = run_on_worker(executor, _SEARCH, Problem.flat_parts, column)
    if not parts:
        return {}
    unbroken = run_on_worker(executor, _SEARCH, Problem.flat_parts, column, result.failures.noise)
    if unbroken:
        return health.warn("flat_part", part=unbroken[0], bound=result.blind_bound)
    reason = f"`{parts[0]}` shows nothing before it fails, which it does in failures that were found"
    return health.warn("unchecked", reason=reason)


def _outliers(
    executor: Executor, problem: Problem, column: int, result: Result, seed: int
) -> tuple[dict[str, str], float]:
    if overrides(problem.system, System.log_weights):
        return {}, 0.0  # rollouts with weights are of another law than the one that is meant
    upper, cost = result.interval[1], 0
    for probe, most, numbers in (
        (probe_outliers, probe_cost, "one number of `{}` far in its tail"),
        (probe_pairs, pair_probe_cost, "numbers of `{}` far in their tails together"),
    ):
        cost += most(problem)
        if result.rollouts < _LOOK_SHARE * cost:
            break
        outlier = run_on_worker(executor, _SEARCH, probe, column, upper, seed, result.confidence)
        if outlier is not None:
            when = {0: "at the start", 1: "at the first step", None: "at a later step"}[outlier.step]
            what = numbers.format(outlier.noise)
            warning = health.warn("outliers", what=what, when=when, low=outlier.low, upper=upper)
            return warning, upper + outlier.low
    return {}, 0.0


def _solver(counts: Mapping[str, int]) -> dict[str, str]:
    solves, fallbacks = counts.get("solves", 0), counts.get("fallback_solves", 0)
    if fallbacks <= 0.01 * solves:
        return {}
    return health.warn("solver_failures", fallbacks=fallbacks, solves=solves)


def _reproduction(
    executor: Executor, result: Result, column: int, again: float, *, rounds: bool
) -> dict[str, str]:
    first: float = result.worst.robustness
    if math.isnan(first) or np.array_equal(first, again):
        return {}
    # Rounding depends on the batch and on nothing else: by itself the rollout repeats.
    tape = result.worst.noise
    again, repeated = (run_on_worker(executor, _REPLAY, _replayed_alone, tape, column) for _ in range(2))
    if first == again == repeated:
        return {}
    spread = float(np.nanstd(result.robustness)) if np.isfinite(result.robustness).any() else 0.0
    small = rounds or abs(first - again) <= 1e-3 * max(abs(first), spread)  # counts as rounding
    name = "rounding" if small and again == repeated else "not_deterministic"
    reason = f"a rollout of robustness {first:.6g}, replayed, differs by {abs(again - first):.2g}"
    return health.warn(name, reason=reason)


def _replayed_alone(problem: Problem, tape: Floats, column: int) -> float:
    outcome = problem.replay(tape[None])
    return math.nan if outcome.error[0] else float(outcome.robustness[0, column])


def _replay_tapes(problem: Problem, tapes: Sequence[Floats]) -> list[float]:
    # Robustness of specification k on tape k; specifications often share their worst rollout.
    rows: dict[bytes, int] = {}
    place = [rows.setdefault(tape.tobytes(), len(rows)) for tape in tapes]
    distinct = [tapes[place.index(row)] for row in range(len(rows))]
    robustness = [
        np.where(outcome.error[:, None], np.nan, outcome.robustness)
        for begin in range(0, len(distinct), problem.chunk)
        for outcome in [problem.replay(np.stack(distinct[begin : begin + problem.chunk]))]
    ]
    table = np.concatenate(robustness)
    return [float(table[row, column]) for column, row in enumerate(place)]
