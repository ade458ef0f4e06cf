"""Runs the comparison: every estimator again and again, each time with its own seed and the same budget."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from avrare.compare.arms import Arm, arm
from avrare.compare.case import Case
from avrare.compare.truth import ENOUGH_FAILURES, Truth, from_monte_carlo
from avrare.errors import AvrareError, UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.loop import Progress, Settings, run
from avrare.estimation.plan import Plan
from avrare.estimation.result import Interval, Result
from avrare.execute.work import Executor
from avrare.plugin.registry import default_registry
from avrare.rollout.noise import NoiseSource

Watch = Callable[[str], Progress]
"""Called with the name of each estimate that begins."""


@dataclass(frozen=True)
class Design:
    """What all estimates have in common.

    Attributes:
        budget: Of each estimate, in steps or rollouts.
        repeat: Repetitions of each estimator; number r has the seed ``seed + r``.
        seed: Of the first repetition.
        workers: Processes; no number depends on them.
    """

    budget: Budget
    repeat: int = 10
    seed: int = 0
    workers: int = 1


@dataclass(frozen=True)
class Repetition:
    """One estimate, without its tapes."""

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
    def of(result: Result, seed: int) -> Repetition:
        """What a comparison keeps of a result."""
        return Repetition(
            seed, result.probability, result.interval, result.relative_error, result.rollouts,
            result.simulated_steps, result.failures.count, result.errors, tuple(result.health),
            result.seconds,
        )  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """An estimator and what it did.

    Attributes:
        arm: The estimator.
        repetitions: Its estimates.
        refusal: Why it cannot take the problem; its estimates, if any, are then no part of any statistic.
    """

    arm: Arm
    repetitions: tuple[Repetition, ...] = ()
    refusal: AvrareError | None = None


@dataclass(frozen=True)
class Comparison:
    """What a comparison found.

    Attributes:
        case: The problem.
        design: What all estimates have in common.
        entries: One for each estimator.
        truth: None where it is not known.
        interrupted: Whether repetitions are missing.
    """

    case: Case
    design: Design
    entries: tuple[Entry, ...]
    truth: Truth | None = None
    interrupted: bool = False


def compare(
    case: Case, arms: Sequence[Arm], design: Design, watch: Watch, truth_rollouts: int | None = None
) -> Comparison:
    """Run the comparison; Ctrl-C ends it with what is done.

    Args:
        case: The problem.
        arms: The estimators.
        design: What all estimates have in common.
        watch: Told what begins; gives the progress of that estimate.
        truth_rollouts: Size of the Monte Carlo run that finds the truth first, None: none is needed.

    Raises:
        UsageError: The budget does not pay for a run of one of the estimators (before anything runs).
        AvrareError: No estimator can take the problem.
        KeyboardInterrupt: Before the first estimate was done.
    """
    entries = {one.label: Entry(one, refusal=refusal(case, one, design)) for one in arms}
    _refuse_if_all_failed(entries)
    if truth_rollouts is not None:
        # Its seed follows those of the repetitions: it shares no rollout with them.
        reference = arm(default_registry(), "mc", {"rollouts": truth_rollouts})
        seed = design.seed + design.repeat
        case = replace(case, truth=from_monte_carlo(_estimate(case, reference, design, seed, None, watch)))
    interrupted = False
    try:
        for label, repetition in _repetitions(case, entries, design, watch):
            entry = entries[label]
            if isinstance(repetition, AvrareError):
                entries[label] = replace(entry, refusal=repetition)
                _refuse_if_all_failed(entries)
            else:
                entries[label] = replace(entry, repetitions=(*entry.repetitions, repetition))
    except KeyboardInterrupt:
        interrupted = True
        if not any(entry.repetitions for entry in entries.values()):
            raise
    done = tuple(entries.values())
    return Comparison(case, design, done, case.truth or pooled(done), interrupted)


def refusal(case: Case, one: Arm, design: Design) -> UsageError | None:
    """Why the estimator cannot take the problem, None if it can; nothing is run.

    Raises:
        UsageError: It could, but the budget does not pay for one run.
        PluginError: Something is not installed.
    """
    try:
        estimator = one.build(case.scene)
        prepare = getattr(estimator, "prepare", None)
        problem = prepare(case.problem) if prepare is not None else case.problem
        noise = NoiseSource(design.seed, problem.noise_size)
        plan = Plan(
            problem.names, problem.steps, problem.chunk, noise, case.confidence, None, case.max_error_rate
        )
        estimator.init(plan)
    except UsageError as error:
        return error
    try:
        estimator.init(replace(plan, budget=design.budget))
    except UsageError as error:
        raise UsageError(f"{one.label}: {error.message}", error.hint) from None
    return None


def pooled(entries: Sequence[Entry]) -> Truth | None:
    """The mean of the comparison's own Monte Carlo estimates, if they saw enough failures."""
    seen = [
        (sum(one.failures for one in entry.repetitions), entry.repetitions)
        for entry in entries
        if entry.arm.name == "mc" and entry.refusal is None
    ]
    failures, repetitions = max(seen, key=lambda pair: pair[0], default=(0, ()))
    if failures < ENOUGH_FAILURES:
        return None
    mean = sum(one.probability for one in repetitions) / len(repetitions)
    return Truth(mean, "pooled monte carlo", None, failures) if mean < 1.0 else None


def _repetitions(
    case: Case, entries: Mapping[str, Entry], design: Design, watch: Watch
) -> Iterator[tuple[str, Repetition | AvrareError]]:
    """One repetition of every estimator after the other, so that an interrupted comparison is a fair one."""
    for r in range(design.repeat):
        for label, one in ((label, entry.arm) for label, entry in entries.items() if not entry.refusal):
            seed, name = design.seed + r, f"{label}  {r + 1}/{design.repeat}"
            try:
                result = _estimate(case, one, design, seed, design.budget, watch, name)
                yield label, Repetition.of(result, seed)
            except AvrareError as error:
                yield label, error


def _estimate(
    case: Case, one: Arm, design: Design, seed: int, budget: Budget | None, watch: Watch, name: str = "truth"
) -> Result:
    settings = Settings(seed, case.confidence, budget, case.max_error_rate)
    executor = _executor(design.workers)
    return run(case.problem, one.build(case.scene), executor, settings, watch(name))[0]


def _executor(workers: int) -> Executor:
    component = default_registry().require("executor", "processes" if workers > 1 else "serial")
    config: Any = component.load_config()(workers=workers)
    return component.load_factory()(config, None)  # type: ignore[no-any-return]


def _refuse_if_all_failed(entries: Mapping[str, Entry]) -> None:
    refusals = {label: entry.refusal for label, entry in entries.items() if entry.refusal is not None}
    if len(refusals) < len(entries):
        return
    first = next(iter(refusals.values()))
    text = "; ".join(f"{label}: {error}" for label, error in refusals.items())
    failure = AvrareError(f"no estimator can take this problem: {text}", first.hint)
    failure.exit_code = first.exit_code
    raise failure
