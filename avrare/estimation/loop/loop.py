"""Estimation loop: ask the estimator for rollouts, run them, tell it the outcomes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, cast

from avrare.base.errors import Interrupted, UsageError
from avrare.base.health_messages import MESSAGES
from avrare.estimation.checks.result_builder import examine
from avrare.estimation.loop.pace import Pace
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.cost_forecast import CostForecast
from avrare.estimation.plan.memory import Forecast, forecast, measure_carry
from avrare.estimation.plan.plan import (
    DelegatesEstimates,
    Estimator,
    GaveUp,
    Info,
    Journal,
    Plan,
    Refused,
    UsesFinalScores,
)
from avrare.estimation.result.fresh_rows import NO_ROWS, FreshRows
from avrare.estimation.result.result import Result
from avrare.plugin.registry import default_registry
from avrare.protocols import (
    NeedsCapabilities,
    PreparesProblem,
    RebuildsCarries,
    StopsEarly,
    find_ability,
    find_notes,
)
from avrare.rollout.chunk_size import spread
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor, HasWorkers, Work, check_reproduces, run_errand
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.worlds.capabilities import declared_limits, refuse_limits, require
from avrare.worlds.determinism import STEPS

Progress = Callable[[Info], None]
DEFAULT_MAX_ERROR_RATE = 0.01


@dataclass(frozen=True)
class Settings:
    """Settings that all estimators share.

    Attributes:
        seed: Seed of all random numbers.
        confidence: Level of the intervals, in (0, 1).
        budget: Upper bound on cost.
        max_error_rate: Share of errors among the rollouts above which a result has the warning ``errors``.
        suppress: Names of health warnings to leave out.
        seen: Counts of rollouts of the target from before (``Plan.seen``).
    """

    seed: int = 0
    confidence: float = 0.95
    budget: Budget | None = None
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    suppress: tuple[str, ...] = ()
    seen: FreshRows = NO_ROWS


def run(
    problem: Problem,
    estimator: Estimator,
    executor: Executor,
    settings: Settings,
    progress: Progress | None = None,
    journal: Journal | None = None,
    stop: Callable[[], bool] | None = None,
) -> list[Result]:
    """Estimate the failure probability of every specification of ``problem``.

    ``progress`` is called after every chunk. Chunks that ``journal`` holds are not run again. ``stop`` is
    called before every chunk: once it returns True, none begins and ``Interrupted`` is raised. A probe of
    the system before, and a replay of the least robust rollout after, are not counted in the cost.
    """
    delegating = find_ability(estimator, DelegatesEstimates)
    if delegating is not None:
        execute = _Parts(executor, progress, journal, stop)
        return delegating.estimate_by(problem, settings, execute)
    with _begin(problem, estimator, settings, executor) as task:
        return task.run(progress, journal, stop)


@contextmanager
def _begin(given: Problem, estimator: Estimator, settings: Settings, executor: Executor) -> Iterator[_Task]:
    """Yield an estimate that may begin; the executor is open until it ends."""
    problem, plan = build_plan(given, estimator, settings)
    work = Work(problem, plan.noise, scored=estimator.single)
    executor.open(work)
    with closing(executor):
        warnings, carry = check_system(problem, estimator, executor)
        memory = forecast(estimator, plan, carry)
        estimator.init(plan)  # refuses a budget that does not pay for it
        yield _Task(given, estimator, settings, work, plan, executor, warnings, memory)


@dataclass(frozen=True)
class _Task:
    """An estimate that may begin: nothing that can be told beforehand speaks against it."""

    given: Problem
    estimator: Estimator
    settings: Settings
    work: Work  # with the problem that the estimator puts in the place of the given one
    plan: Plan
    executor: Executor
    warnings: dict[str, str]
    memory: Forecast

    def run(
        self, progress: Progress | None, journal: Journal | None, stop: Callable[[], bool] | None
    ) -> list[Result]:
        estimator, executor, problem = self.estimator, self.executor, self.work.problem
        loop = _Loop(
            estimator, self.plan, self.work, executor, progress or (lambda info: None), journal, stop
        )
        try:
            state = loop.run()
        except GaveUp as end:
            end.seconds = loop.seconds
            raise
        seconds = loop.seconds
        # Otherwise its tapes may belong to another system, or its robustness to a part of the rollout.
        replayed = problem is self.given and not _stops_early(estimator)
        found = estimator.estimate(state)
        suppress, seed = self.settings.suppress, self.settings.seed
        results = examine(
            problem, found, self.warnings, executor, replay=replayed, suppress=suppress, seed=seed
        )
        return [replace(result, seconds=seconds) for result in results]


def build_plan(problem: Problem, estimator: Estimator, settings: Settings) -> tuple[Problem, Plan]:
    """Prepare the problem and the plan; run nothing."""
    if not (isinstance(settings.confidence, (int, float)) and 0.0 < settings.confidence < 1.0):
        raise UsageError(f"confidence must lie between 0 and 1, not {settings.confidence!r}")
    notes = find_notes(problem.system)
    default_registry().check_suppressed(name for name in settings.suppress if name not in notes)
    if estimator.single and len(problem.names) > 1:
        raise UsageError(
            f"{estimator.name} estimates one specification at a time, not {', '.join(problem.names)}"
        )
    refuse_limits(estimator.name, declared_limits(problem.system), _needs(estimator))
    problem = prepare_problem(estimator, problem)
    noise = NoiseSource(settings.seed, problem.noise_size)
    plan = Plan(
        problem.names,
        problem.steps,
        problem.chunk,
        noise,
        settings.confidence,
        settings.budget,
        settings.max_error_rate,
        settings.seen,
    )
    return problem, plan


def check_estimate(
    problem: Problem, estimator: Estimator, settings: Settings
) -> tuple[dict[str, str], Forecast]:
    """Return the health warnings on a problem's system, found by a few steps, and the memory of an estimate.

    Raises:
        UsageError: The estimate could not begin.
    """
    with _begin(problem, estimator, settings, SerialExecutor()) as task:
        return task.warnings, task.memory


def check_system(
    problem: Problem, estimator: Estimator, executor: Executor | None = None
) -> tuple[dict[str, str], int]:
    """Return the health warnings on a prepared problem's system, and the bytes of a particle's carry.

    Both come from a few steps of a few rows, which an open executor runs; None: a serial one.

    Raises:
        UsageError: The system breaks a rule that the estimator relies on.
    """
    if executor is None:
        with closing(SerialExecutor()) as serial:
            serial.open(Work(problem, NoiseSource(0, problem.noise_size), scored=False))
            return check_system(problem, estimator, serial)
    name, needs = estimator.name, _needs(estimator)
    reasons, carry = run_errand(executor, "the probe before the estimate", _probe, name, needs)
    return {name: MESSAGES[name].format(reason=reason) for name, reason in reasons.items()}, carry


def _probe(problem: Problem, estimator: str, needs: tuple[str, ...]) -> tuple[dict[str, str], int]:
    reasons = require(problem.system, estimator, needs, min(STEPS, problem.steps))
    return reasons, measure_carry(problem)


def _needs(estimator: Estimator) -> tuple[str, ...]:
    needing = find_ability(estimator, NeedsCapabilities)
    return needing.needs if needing is not None else ()


def prepare_problem(estimator: Estimator, problem: Problem) -> Problem:
    """Return the problem that an estimator puts in the place of ``problem``, or ``problem`` itself."""
    preparing = find_ability(estimator, PreparesProblem)
    return problem if preparing is None else cast("Problem", preparing.prepare(problem))


def _stops_early(estimator: Estimator) -> bool:
    stopping = find_ability(estimator, StopsEarly)
    return stopping is not None and stopping.stops_early


@dataclass
class _Parts:
    """The parts of an estimate, run one after another; the progress goes on from one to the next."""

    executor: Executor
    progress: Progress | None
    journal: Journal | None
    stop: Callable[[], bool] | None
    before: Info = field(default_factory=Info)

    def __call__(self, problem: Problem, estimator: Estimator, settings: Settings, name: str) -> list[Result]:
        journal, before, last = self.journal and self.journal.part(name), self.before, Info()

        def watch(info: Info) -> None:
            nonlocal last
            last = info
            if self.progress is not None:
                self.progress(before.before(info))

        with ExitStack() as stack:
            try:
                task = stack.enter_context(_begin(problem, estimator, settings, self.executor))
            except UsageError as error:
                raise Refused(error.message, error.hint) from None
            try:
                return task.run(watch, journal, self.stop)
            finally:
                self.before = before.before(last)


class _Loop:
    def __init__(
        self,
        estimator: Estimator,
        plan: Plan,
        work: Work,
        executor: Executor,
        progress: Progress,
        journal: Journal | None,
        stop: Callable[[], bool] | None,
    ) -> None:
        self.estimator, self.plan, self.work, self.executor = estimator, plan, work, executor
        self.progress, self.journal, self.stop = progress, journal, stop or (lambda: False)
        self.began = time.perf_counter()
        self.pace, self.stopped = Pace(), False

    @property
    def seconds(self) -> float:
        """Wall time since the start, without the time between an interruption and its resumption [s]."""
        return time.perf_counter() - self.began

    def run(self) -> Any:
        """Run until the estimator asks for no more rollouts; return its state."""
        stage, (state, info) = 0, self.estimator.init(self.plan)
        while not self._out_of_time(info) and (request := self.estimator.ask(state)) is not None:
            parts, so_far = [], info
            for part in self._outcomes(stage, request):
                parts.append(self._needed(part))
                so_far = so_far.plus(part)
                self._show(so_far, request.rows, so_far.rollouts - info.rollouts)
            if not parts:  # the time left pays for no more
                break
            joined = Rollouts.join(parts)
            parts.clear()  # its memory is for the estimator now
            state, info = self.estimator.tell(state, joined)
            del joined
            self._show(info)
            stage += 1
        return state

    def _show(self, info: Info, rows: int = 0, done: int = 0) -> None:
        if self.plan.budget is not None and self._timed:
            amount = self.plan.budget.amount  # an estimator with a forecast may stop before
            forecast = CostForecast("seconds", 0.0 if info.forecast else amount, amount)
            info = replace(info, forecast=forecast)
        self.progress(replace(info, stage_rows=rows if done < rows else 0, stage_done=done))

    def _needed(self, part: Rollouts) -> Rollouts:
        final = find_ability(self.estimator, UsesFinalScores)
        if final is None or not final.final_scores:
            return part
        return replace(part, scores=part.scores[:, -1:].copy())

    def _outcomes(self, stage: int, request: Request) -> Iterator[Rollouts]:
        journal = self.journal if self._can_store(request) else None
        index = done = 0
        for outcome in self._stored(journal, stage, request) if journal else ():
            index, done = index + 1, done + len(outcome.error)
            yield outcome
        if journal and self._timed and journal.rows(stage + 1, 0):
            return  # the time left did not pay for the rest of this stage, or so it seemed
        sent: deque[Request] = deque()
        for outcome in self.executor.map(self._pieces(request, done, sent, stage)):
            chunk = sent.popleft()
            self.pace.finish(chunk.rows)
            if journal:
                journal.write(stage, index, chunk, outcome, self.seconds)
            index, done = index + 1, done + chunk.rows
            yield outcome
        if done < request.rows and (self.stopped or not self._timed):
            raise Interrupted("interrupted")

    def _pieces(self, request: Request, at: int, sent: deque[Request], stage: int) -> Iterator[Request]:
        # A piece of a chunk gives the same bits; a budget of seconds has pieces that fit into the time left.
        most = self._piece(request.rows - at)
        while at < request.rows and not self._asked_to_stop():
            size = min(most, request.rows - at)
            if self._timed:
                size = self.pace.take(self.seconds, self._time_left, size, first=stage == 0 and at == 0)
            if not size:
                return
            sent.append(request.slice(at, at + size))
            at += size
            yield sent[-1]

    def _piece(self, rows: int) -> int:
        if self.work.problem.named_chunk is not None:
            return self.plan.chunk
        having = find_ability(self.executor, HasWorkers)
        return spread(rows, self.plan.chunk, having.workers if having is not None else 1)

    def _asked_to_stop(self) -> bool:
        self.stopped = self.stopped or self.stop()
        return self.stopped

    def _can_store(self, request: Request) -> bool:
        if not request.keep_carries:
            return True
        rebuilding = find_ability(self.estimator, RebuildsCarries)
        return rebuilding is not None and rebuilding.rebuilds_carries

    def _stored(self, journal: Journal, stage: int, request: Request) -> Iterator[Rollouts]:
        at = index = 0
        while at < request.rows:
            chunk = request.slice(at, at + (journal.rows(stage, index) or 1))
            found = journal.read(stage, index, chunk)
            if found is None:
                return
            outcome, seconds = found
            self._check_shape(f"{stage:06d}-{index:06d}", chunk, outcome)
            # A law that was learnt again may differ: check each stage that draws under one.
            if index == 0 and (stage == 0 or chunk.law is not None):
                check_reproduces(self._repeat, chunk, outcome)
            self.began = time.perf_counter() - seconds
            at, index = at + chunk.rows, index + 1
            yield outcome

    def _repeat(self, chunk: Request) -> Rollouts:
        (outcome,) = self.executor.map([chunk])
        return outcome  # type: ignore[no-any-return]

    def _check_shape(self, name: str, chunk: Request, outcome: Rollouts) -> None:
        wanted = (chunk.rows, len(self.plan.names)), self.plan.steps + 1 if self.work.scored else 0
        if (outcome.robustness.shape, outcome.scores.shape[1]) != wanted:
            hint = "remove this file: its rollouts are then run again"
            raise UsageError(f"{name}.npz of the checkpoint is damaged: it is of another shape", hint)

    @property
    def _timed(self) -> bool:
        return self.plan.budget is not None and self.plan.budget.kind == "seconds"

    @property
    def _time_left(self) -> float:
        assert self.plan.budget is not None
        return self.plan.budget.amount - self.seconds

    def _out_of_time(self, info: Info) -> bool:
        return self._timed and bool(info.rollouts) and self._time_left <= 0.0
