"""Comparison study: repeated estimates of every estimator, with the same seeds and the same budget."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from avrare.analysis.compare.case import ENOUGH_FAILURES, POOLED, ComparisonCase, GroundTruth
from avrare.analysis.compare.estimator_options import Arm, make_arm
from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.loop import Progress, Settings, prepare_problem, run
from avrare.estimation.plan import Plan
from avrare.estimation.result import Interval, Result
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.work import build_executor
from avrare.rollout.noise import NoiseSource

StudyWatch = Callable[[str], Progress]
"""Called with a label as each estimate begins; gives its progress display."""


@dataclass(frozen=True)
class StudyDesign:
    """Settings that all estimates of a study share."""

    budget: Budget  # of each estimate, in steps or rollouts
    repeat: int = 10  # repetition number r has the seed ``seed + r``
    seed: int = 0
    workers: int = 1  # no number depends on them


@dataclass(frozen=True)
class Repetition:
    """One estimate of a study, without its noise tapes; fields as in ``Result``."""

    seed: int
    probability: float
    interval: Interval
    relative_error: float
    rollouts: int
    simulated_steps: int
    failures: int
    errors: int
    health: tuple[str, ...]
    seconds: float

    @staticmethod
    def from_result(result: Result, seed: int) -> Repetition:
        """Return a result without its noise tapes."""
        return Repetition(
            seed, result.probability, result.interval, result.relative_error, result.rollouts,
            result.simulated_steps, result.failures.count, result.errors, tuple(result.health),
            result.seconds,
        )  # fmt: skip


@dataclass(frozen=True)
class ArmResult:
    """Estimates of one estimator."""

    arm: Arm
    repetitions: tuple[Repetition, ...] = ()
    refusal: AvrareError | None = None  # if it cannot take the problem; its estimates enter no statistic


@dataclass(frozen=True)
class Comparison:
    """Result of a study."""

    case: ComparisonCase
    design: StudyDesign
    arms: tuple[ArmResult, ...]
    truth: GroundTruth | None = None
    interrupted: bool = False  # repetitions are missing


def compare(
    case: ComparisonCase,
    arms: Sequence[Arm],
    design: StudyDesign,
    watch: StudyWatch,
    truth_rollouts: int | None = None,
) -> Comparison:
    """Run the study; Ctrl-C ends it with the repetitions that are complete.

    A Monte Carlo run of ``truth_rollouts`` first estimates the truth. UsageError, before anything runs, if
    the budget does not pay for a run of one of the estimators; AvrareError if none can take the problem;
    KeyboardInterrupt before the first estimate is complete.
    """
    # 1. Find the estimators that cannot take the problem.
    results = {arm.label: ArmResult(arm, refusal=_find_refusal(case, arm, design)) for arm in arms}
    _require_one_accepted(results)
    # 2. Estimate the truth; its seed follows those of the repetitions, so it shares no rollout with them.
    if truth_rollouts is not None:
        reference = make_arm(default_registry(), "mc", {"rollouts": truth_rollouts})
        seed = design.seed + design.repeat
        found = _estimate(case, reference, design, seed, None, watch, "truth")
        case = replace(case, truth=GroundTruth.from_monte_carlo(found))
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


def _find_refusal(case: ComparisonCase, arm: Arm, design: StudyDesign) -> UsageError | None:
    try:
        estimator = arm.build(case.scene)
        problem = prepare_problem(estimator, case.problem)
        noise = NoiseSource(design.seed, problem.noise_size)
        plan = Plan(
            problem.names, problem.steps, problem.chunk, noise, case.confidence, None, case.max_error_rate
        )
        estimator.init(plan)
    except UsageError as error:
        return error
    try:
        estimator.init(replace(plan, budget=design.budget))
    except UsageError as error:  # it takes the problem, but the budget does not pay for one run
        raise UsageError(f"{arm.label}: {error.message}", error.hint) from None
    return None


def _pool_monte_carlo(results: Sequence[ArmResult]) -> GroundTruth | None:
    candidates = [
        (sum(one.failures for one in result.repetitions), result.repetitions)
        for result in results
        if result.arm.name == "mc" and result.refusal is None
    ]
    failures, repetitions = max(candidates, key=lambda pair: pair[0], default=(0, ()))
    if failures < ENOUGH_FAILURES:
        return None
    mean = sum(one.probability for one in repetitions) / len(repetitions)
    return GroundTruth(mean, POOLED, None, failures) if mean < 1.0 else None


def _run_repetitions(
    case: ComparisonCase, results: Mapping[str, ArmResult], design: StudyDesign, watch: StudyWatch
) -> Iterator[tuple[str, Repetition | AvrareError]]:
    # The estimators alternate, so that an interrupted study compares equal numbers.
    for r in range(design.repeat):
        for label, arm in ((label, result.arm) for label, result in results.items() if not result.refusal):
            seed, name = design.seed + r, f"{label}  {r + 1}/{design.repeat}"
            try:
                result = _estimate(case, arm, design, seed, design.budget, watch, name)
                yield label, Repetition.from_result(result, seed)
            except AvrareError as error:
                yield label, error


def _estimate(
    case: ComparisonCase, arm: Arm, design: StudyDesign, seed: int, budget: Budget | None,
    watch: StudyWatch, label: str,
) -> Result:  # fmt: skip
    settings = Settings(seed, case.confidence, budget, case.max_error_rate)
    executor = build_executor(design.workers)
    return run(case.problem, arm.build(case.scene), executor, settings, watch(label))[0]


def _require_one_accepted(results: Mapping[str, ArmResult]) -> None:
    refusals = {label: result.refusal for label, result in results.items() if result.refusal is not None}
    if len(refusals) < len(results):
        return
    first = next(iter(refusals.values()))
    text = "; ".join(f"{label}: {error.message}" for label, error in refusals.items())
    failure = AvrareError(f"no estimator can take this problem: {text}", first.hint)
    failure.exit_code = first.exit_code
    raise failure
