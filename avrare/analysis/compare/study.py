"""Comparison study: repeated estimates of every estimator, with the same seeds and the same budget."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from avrare.analysis.compare import REPEAT
from avrare.analysis.compare.case import (
    ENOUGH_FAILURES,
    POOLED,
    ComparisonCase,
    GroundTruth,
    open_case,
    parse_truth,
)
from avrare.analysis.compare.comparison import ArmResult, Comparison, StudyDesign
from avrare.analysis.compare.estimator_options import Arm, make_arm, parse_arms, split_settings
from avrare.base.errors import AvrareError, UsageError
from avrare.base.number_format import format_duration
from avrare.estimation.loop.loop import Progress, run
from avrare.estimation.loop.preflight import check_estimate
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.result import Result
from avrare.plugin.registry import default_registry
from avrare.rollout.child_process import run_guarded
from avrare.rollout.executors.work import build_executor
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.scenario.overrides import as_settings

StudyWatch = Callable[[str, Problem], Progress]
"""Called with a label and the problem as each estimate begins; gives its progress display."""


def compare(
    subject: Problem | str | os.PathLike[str],
    estimators: str | Sequence[str],
    budget: Budget | Mapping[str, float] | str,
    specification: str | None = None,
    *,
    overrides: Sequence[str] = (),
    truth: float | str | None = None,
    repeat: int = REPEAT,
    seed: int | None = None,
    workers: int = 1,
    watch: StudyWatch | None = None,
    announce: Callable[[str], None] | None = None,
    safe: bool = False,
) -> Comparison:
    """Compare estimators: each makes several estimates with the same seeds and the same budget.

    Args:
        subject: Scenario file, a problem, or ``"problem:ID"`` for one with a known probability.
        estimators: Names, with options where wanted: ``"mc,ams:particles=100"``, or a list of them.
        budget: Budget of each estimate, in steps or rollouts.
        specification: Name; None: the only one.
        overrides: Settings: ``"ams.particles=100"`` for every ams, ``"scenario.steps=20"`` for the scenario.
        truth: True probability, or ``"mc=1e6"`` to estimate it first.
        repeat: Number of estimates of each estimator.
        seed: Seed of the first of them; None: the scenario's, or 0.
        workers: Number of processes; changes no number.
        watch: Progress display.
        announce: Called with a line on the estimates to come, and about how long they take.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: An argument does not fit, or the budget does not pay for one run of an estimator.
        AvrareError: No estimator can take the problem.
    """
    parsed_budget, true_value = parse_cost(budget), None if truth is None else parse_truth(str(truth))
    of_scenario, of_estimators = split_settings(as_settings(overrides))
    case = open_case(subject, specification, of_scenario, true_value, safe)
    names = estimators if isinstance(estimators, str) else ",".join(estimators)
    arms = parse_arms(names, of_estimators, case.estimator, default_registry())
    design = StudyDesign(parsed_budget, repeat, case.seed if seed is None else seed, workers)

    def begin(label: str, problem: Problem) -> Progress:
        return watch(f"{case.name}  {label}", problem) if watch is not None else lambda info: None

    return run_study(case, arms, design, begin, true_value if isinstance(true_value, int) else None, announce)


def parse_cost(budget: Budget | Mapping[str, float] | str) -> Budget:
    """Return a budget in steps or rollouts.

    Raises:
        UsageError: It is one of time.
    """
    parsed = Budget.parse(budget)
    assert parsed is not None
    if parsed.kind == "seconds":
        raise UsageError(
            "a budget of seconds is not comparable: its cost differs between machines and runs",
            "give steps=N or rollouts=N",
        )
    return parsed


def run_study(
    case: ComparisonCase,
    arms: Sequence[Arm],
    design: StudyDesign,
    watch: StudyWatch,
    truth_rollouts: int | None = None,
    announce: Callable[[str], None] | None = None,
) -> Comparison:
    """Run the study; Ctrl-C ends it with the repetitions that are complete.

    A Monte Carlo run of ``truth_rollouts`` first estimates the truth. UsageError, before anything runs, if
    the budget does not pay for a run of one of the estimators; AvrareError if none can take the problem;
    KeyboardInterrupt before the first estimate is complete.
    """
    # 1. Find the estimators that cannot take the problem.
    results = {arm.label: ArmResult(arm, refusal=_find_refusal(case, arm, design)) for arm in arms}
    _require_one_accepted(results)
    if announce is not None:
        announce(_forecast(case, design, sum(result.refusal is None for result in results.values())))
    # 2. Estimate the truth; its seed follows those of the repetitions, so it shares no rollout with them.
    if truth_rollouts is not None:
        reference = make_arm(default_registry(), "mc", {"rollouts": truth_rollouts})
        seed = design.seed + design.repeat
        long_run = _estimate(case, reference, design, seed, None, watch, "truth")
        case = replace(case, truth=GroundTruth.from_monte_carlo(long_run))
    # 3. Run the repetitions.
    interrupted = False
    try:
        for label, repetition in _run_repetitions(case, results, design, watch):
            result = results[label]
            if isinstance(repetition, AvrareError):
                results[label] = replace(result, refusal=repetition)
                _require_one_accepted(results)
            else:
                results[label] = replace(result, repetitions=(*result.repetitions, repetition))
    except KeyboardInterrupt:
        interrupted = True
        if not any(result.repetitions for result in results.values()):
            raise
    done = tuple(results.values())
    return Comparison(case, design, done, case.truth or _pool_monte_carlo(done), interrupted)


def _forecast(case: ComparisonCase, design: StudyDesign, arms: int) -> str:
    """Return the estimates of a study and their approximate duration, from a few uncounted rollouts."""
    problem, budget = case.problem, design.budget
    noise = NoiseSource(design.seed, problem.noise_size)

    def time_rollouts(rows: int) -> float:
        began = time.perf_counter()
        problem.simulate(noise, Request.from_start(np.zeros(rows, np.int64), np.arange(rows)), scored=False)
        return time.perf_counter() - began

    timed_rollouts = 8  # rollouts that are timed before a study
    purpose, sizes = "the rollouts that tell how long the comparison takes", (1, 1, timed_rollouts)
    _, call, more = run_guarded(purpose, problem.system, lambda: [time_rollouts(rows) for rows in sizes])
    rollouts = budget.amount / (max(problem.steps, 1) if budget.kind == "steps" else 1)
    each = math.ceil(rollouts / problem.chunk) * call + rollouts * max(more - call, 0.0) / (
        timed_rollouts - 1
    )
    estimates = design.repeat * arms
    duration = format_duration(each * estimates / design.workers)
    return f"{estimates} estimates of {rollouts:,.0f} rollouts: {duration} or more"


def _find_refusal(case: ComparisonCase, arm: Arm, design: StudyDesign) -> UsageError | None:
    try:
        settings = Settings(design.seed, case.confidence, None, case.max_error_rate)
        clearance = check_estimate(case.problem, arm.build(case.scene), settings)
    except UsageError as error:
        return error
    try:
        clearance.estimator.init(replace(clearance.plan, budget=design.budget))
    except UsageError as error:  # it takes the problem, but the budget does not pay for one run
        raise UsageError(f"{arm.label}: {error.message}", error.hint) from None
    return None


def _pool_monte_carlo(results: Sequence[ArmResult]) -> GroundTruth | None:
    candidates = [
        (sum(estimate.failures.count for estimate in result.repetitions), result.repetitions)
        for result in results
        if result.arm.name == "mc" and result.refusal is None
    ]
    failures, repetitions = max(candidates, key=lambda pair: pair[0], default=(0, ()))
    if failures < ENOUGH_FAILURES:
        return None
    mean = sum(estimate.probability for estimate in repetitions) / len(repetitions)
    return GroundTruth(mean, POOLED, None, failures) if mean < 1.0 else None


def _run_repetitions(
    case: ComparisonCase, results: Mapping[str, ArmResult], design: StudyDesign, watch: StudyWatch
) -> Iterator[tuple[str, Result | AvrareError]]:
    # The estimators alternate, so that an interrupted study compares equal numbers.
    for r in range(design.repeat):
        for label, arm in ((label, result.arm) for label, result in results.items() if not result.refusal):
            seed, name = design.seed + r, f"{label}  {r + 1}/{design.repeat}"
            try:
                result = _estimate(case, arm, design, seed, design.budget, watch, name)
                yield label, result.without_tapes()
            except AvrareError as error:
                yield label, error


def _estimate(
    case: ComparisonCase,
    arm: Arm,
    design: StudyDesign,
    seed: int,
    budget: Budget | None,
    watch: StudyWatch,
    label: str,
) -> Result:
    settings = Settings(seed, case.confidence, budget, case.max_error_rate)
    executor = build_executor(design.workers)
    return run(case.problem, arm.build(case.scene), executor, settings, watch(label, case.problem))[0]


def _require_one_accepted(results: Mapping[str, ArmResult]) -> None:
    refusals = {label: result.refusal for label, result in results.items() if result.refusal is not None}
    if len(refusals) < len(results):
        return
    first = next(iter(refusals.values()))
    text = "; ".join(f"{label}: {error.message}" for label, error in refusals.items())
    failure = AvrareError(f"no estimator can take this problem: {text}", first.hint)
    failure.exit_code = first.exit_code
    raise failure
