"""The estimation loop: ask, run, tell. The core owns the clock, the executor and the progress line."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

from pydantic import ValidationError

from avrare.errors import Interrupted, UsageError, did_you_mean
from avrare.estimation.budget import Budget
from avrare.estimation.checks import examined
from avrare.estimation.health import check_names
from avrare.estimation.plan import Estimator, Info, Journal, Plan
from avrare.estimation.result import Result
from avrare.execute.again import check_again
from avrare.execute.work import Executor, Work
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.worlds.capabilities import require

Progress = Callable[[Info], None]
DEFAULT_MAX_ERROR_RATE = 0.01
_ARGUMENTS = ("seed", "workers", "confidence", "budget", "suppress", "checkpoint")
"""What ``avrare.estimate`` takes beside the options: for the hint on a misspelt one."""


@dataclass(frozen=True)
class Settings:
    """What every estimator has in common.

    Attributes:
        seed: Of all random numbers.
        confidence: Of the intervals.
        budget: Upper bound on cost.
        max_error_rate: Share of broken rollouts above which a result is unhealthy.
        suppress: Names of health warnings to leave out.
        replay: Drive the least robust rollout once more to see that it comes out the same; beyond the cost.
    """

    seed: int = 0
    confidence: float = 0.95
    budget: Budget | None = None
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    suppress: tuple[str, ...] = ()
    replay: bool = False


def run(
    problem: Problem, estimator: Estimator, executor: Executor, settings: Settings,
    progress: Progress | None = None, journal: Journal | None = None, stop: Callable[[], bool] | None = None,
) -> list[Result]:  # fmt: skip
    """Estimate the failure probability of every specification of ``problem``.

    An estimator with ``prepare(problem) -> problem`` may put another problem in its place; one with ``needs``
    (``avrare.worlds.capabilities``) is refused where a simulator lacks them.

    Args:
        problem: What to estimate.
        estimator: How.
        executor: Where the chunks run.
        settings: What every estimator has in common.
        progress: Told after every chunk.
        journal: Where outcomes are kept; those that it has are not run again.
        stop: Asked before every chunk; once it is true no other begins.

    Raises:
        UsageError: The estimator takes one specification and the problem has several; or the system does not
            give what the journal has kept of it.
        Interrupted: ``stop`` was true before the end.
    """
    given = problem
    problem, plan = planned(given, estimator, settings)
    work = Work(problem, plan.noise, scored=estimator.single)
    drive = _Drive(estimator, plan, work, executor, progress or (lambda info: None), journal, stop)
    executor.open(work)
    with closing(executor):
        state = drive.run()
    seconds = drive.seconds
    # Else its tapes may be those of another system, or its robustness that of a part of the run.
    replayed = settings.replay and problem is given and not getattr(estimator, "stops_early", False)
    results = [
        examined(problem, result, column, replay=replayed, suppress=settings.suppress)
        for column, result in enumerate(estimator.estimate(state))
    ]
    return [replace(result, seconds=seconds) for result in results]


def planned(problem: Problem, estimator: Estimator, settings: Settings) -> tuple[Problem, Plan]:
    """The problem as the estimator will have it, and what it is told of it; nothing is driven.

    Raises:
        UsageError: As of ``run``, before it begins.
    """
    if not (isinstance(settings.confidence, (int, float)) and 0.0 < settings.confidence < 1.0):
        raise UsageError(f"confidence must lie between 0 and 1, not {settings.confidence!r}")
    check_names(settings.suppress)
    if estimator.single and len(problem.names) > 1:
        raise UsageError(
            f"{estimator.name} estimates one specification at a time, not {', '.join(problem.names)}"
        )
    require(problem.system, estimator.name, getattr(estimator, "needs", ()))
    prepare = getattr(estimator, "prepare", None)
    if prepare is not None:
        problem = prepare(problem)
    noise = NoiseSource(settings.seed, problem.noise_size)
    plan = Plan(
        problem.names, problem.steps, problem.chunk, noise, settings.confidence, settings.budget,
        settings.max_error_rate,
    )  # fmt: skip
    return problem, plan


class _Drive:
    """One estimate under way."""

    def __init__(
        self, estimator: Estimator, plan: Plan, work: Work, executor: Executor, progress: Progress,
        journal: Journal | None, stop: Callable[[], bool] | None,
    ) -> None:  # fmt: skip
        self.estimator, self.plan, self.work, self.executor = estimator, plan, work, executor
        self.progress, self.journal, self.stop = progress, journal, stop or (lambda: False)
        self.began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Since the start, without the time between an interruption and going on."""
        return time.perf_counter() - self.began

    def run(self) -> Any:
        """The estimator's state once it asks for no more."""
        stage, (state, info) = 0, self.estimator.init(self.plan)
        while not self._out_of_time(info) and (request := self.estimator.ask(state)) is not None:
            parts, so_far = [], info
            for part in self._outcomes(stage, request):
                parts.append(part)
                so_far = so_far.plus(part)
                self.progress(so_far)
            state, info = self.estimator.tell(state, Rollouts.join(parts))
            self.progress(info)
            stage += 1
        return state

    def _outcomes(self, stage: int, request: Request) -> Iterator[Rollouts]:
        """Of all chunks in order: first what the journal has, then what is run."""
        size = self.plan.chunk
        chunks = [request.slice(at, at + size) for at in range(0, request.rows, size)]
        journal = self.journal if self._kept(request) else None
        index = 0
        for outcome in self._stored(journal, stage, chunks) if journal else ():
            index += 1
            yield outcome
        wanted = takewhile(lambda _: not self.stop(), chunks[index:])
        for outcome in self.executor.map(wanted):
            if journal:
                journal.write(stage, index, chunks[index], outcome, self.seconds)
            index += 1
            yield outcome
        if index < len(chunks):
            raise Interrupted("interrupted")

    def _kept(self, request: Request) -> bool:
        return not request.keep_carries or getattr(self.estimator, "rebuilds_carries", False)

    def _stored(self, journal: Journal, stage: int, chunks: list[Request]) -> Iterator[Rollouts]:
        """Of the leading chunks; the clock is put to where it stood after each."""
        for index, chunk in enumerate(chunks):
            found = journal.read(stage, index, chunk)
            if found is None:
                return
            outcome, seconds = found
            # A law that was learnt anew may have come out otherwise: try each stage that draws under one.
            if index == 0 and (stage == 0 or chunk.law is not None):
                check_again(self.work, chunk, outcome)
            self.began = time.perf_counter() - seconds
            yield outcome

    def _out_of_time(self, info: Info) -> bool:
        """Whether a budget of seconds (Monte Carlo only) is spent; never before the first rollouts are in."""
        budget = self.plan.budget
        if budget is None or budget.kind != "seconds" or not info.rollouts:
            return False
        return self.seconds >= budget.amount


def checked_options(config: type[Any], name: str, options: dict[str, Any], kind: str = "estimator") -> Any:
    """Options of an estimator called from Python, or of another ``kind`` of component.

    Raises:
        UsageError: Unknown or invalid options, all of them named.
    """
    try:
        return config(**options)
    except ValidationError as error:
        problems, hints = [], []
        for entry in error.errors():
            option = ".".join(str(part) for part in entry["loc"])
            if entry["type"] == "extra_forbidden":
                problems.append(f"unknown option {option!r} of {kind} {name!r}")
                hints.append(
                    did_you_mean(option, [*config.model_fields, *(_ARGUMENTS if kind == "estimator" else ())])
                )
            elif option:
                problems.append(
                    f"option {option!r} of {kind} {name!r}: {entry['msg']}, found {entry['input']!r}"
                )
            else:
                problems.append(f"{kind} {name!r}: {entry['msg'].removeprefix('Value error, ')}")
        raise UsageError("; ".join(problems), "; ".join(filter(None, hints)) or None) from None
