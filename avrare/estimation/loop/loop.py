"""Estimation loop: ask the estimator for rollouts, run them at the budget's pace, tell it the outcomes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from avrare.base.errors import FIRST_ROLLOUTS, EveryRolloutBroke, Interrupted, UsageError
from avrare.estimation.checks.result_builder import examine
from avrare.estimation.loop.preflight import Clearance, clear_estimate
from avrare.estimation.plan.plan import (
    CostForecast,
    Estimator,
    GaveUp,
    Info,
    Journal,
    Plan,
    Refused,
    Settings,
)
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.executors.work import Executor, Work, check_reproduces
from avrare.rollout.problem import Problem
from avrare.rollout.request import FROM_START, Request, Rollouts, spread
from avrare.rollout.tape_source import TapeDrawer


@dataclass
class Pace:
    """Rows per second since the first was given out.

    The start of workers counts: several outcomes that arrive at once say nothing of how long one takes.
    """

    began: float | None = None  # time at which the first row was given out [s]
    rows: int = 0  # finished
    flight: int = 0  # given out and not finished

    def take(self, now: float, left: float, most: int, first: bool = False) -> int:
        """Return how many of ``most`` rows to run next in the remaining seconds ``left``.

        The ``first`` row of an estimate runs however little time is left, or there would be no result.
        """
        if self.began is None:
            self.began = now
        rows = 1 if first or left > 0.0 else 0  # one at a time, until an outcome says how long that takes
        if self.rows:
            rate = self.rows / max(now - self.began, 1e-9)
            rows = max(min(most, int(rate * left) - self.flight), 0)
        self.flight += rows
        return rows

    def finish(self, rows: int) -> None:
        """Count the rows of an outcome."""
        self.flight -= rows
        self.rows += rows


Progress = Callable[[Info], None]


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
    results = estimator.estimate_by(problem, settings, _Parts(executor, progress, journal, stop))
    if results is not None:
        return results
    with clear_estimate(problem, estimator, settings, executor) as clearance:
        return _run_loop(clearance, executor, progress, journal, stop)


def _run_loop(
    clearance: Clearance,
    executor: Executor,
    progress: Progress | None,
    journal: Journal | None,
    stop: Callable[[], bool] | None,
) -> list[Result]:
    estimator, settings, work = clearance.estimator, clearance.settings, clearance.work
    loop = _Loop(estimator, clearance.plan, work, executor, progress or (lambda info: None), journal, stop)
    try:
        state = loop.run()
    except GaveUp as end:
        end.seconds = loop.seconds
        raise
    seconds = loop.seconds
    # Otherwise its tapes may belong to another system, or its robustness to a part of the rollout.
    replays = work.problem is clearance.problem and not estimator.stops_early
    results = examine(
        work.problem,
        estimator.estimate(state),
        clearance.warnings,
        executor,
        replay=replays,
        suppress=settings.suppress,
        seed=settings.seed,
    )
    tapes = tuple(loop.error_tapes)
    return [replace(result, seconds=seconds, error_tapes=tapes) for result in results]


@dataclass
class _Parts:
    """The parts of an estimate, run one after another, with a progress that counts them all."""

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
                clearance = stack.enter_context(clear_estimate(problem, estimator, settings, self.executor))
            except UsageError as error:
                raise Refused(error.message, error.hint) from None
            try:
                return _run_loop(clearance, self.executor, watch, journal, self.stop)
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
        self.error_tapes: list[Floats] = []

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
                parts.append(self._drop_unused_scores(part))
                so_far = so_far.plus(part)
                hopeless = FIRST_ROLLOUTS <= so_far.errors == so_far.rollouts
                if hopeless and (stage == 0 or request.is_fresh):
                    raise EveryRolloutBroke.after(so_far.messages[0])
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
        if self.plan.budget is not None and self._has_time_limit:
            amount = self.plan.budget.amount  # an estimator with a forecast may stop before
            forecast = CostForecast("seconds", 0.0 if info.forecast else amount, amount)
            info = replace(info, forecast=forecast)
        self.progress(replace(info, stage_rows=rows if done < rows else 0, stage_done=done))

    def _drop_unused_scores(self, part: Rollouts) -> Rollouts:
        return replace(part, scores=part.scores[:, -1:].copy()) if self.estimator.final_scores else part

    def _outcomes(self, stage: int, request: Request) -> Iterator[Rollouts]:
        journal = self.journal if self._can_store(request) else None
        index = done = 0
        for outcome in self._read_journal(journal, stage, request) if journal else ():
            index, done = index + 1, done + len(outcome.error)
            yield outcome
        if journal and self._has_time_limit and journal.has(stage + 1):
            return  # the time left did not pay for the rest of this stage, or so it seemed
        sent: deque[Request] = deque()
        for outcome in self.executor.map(self._pieces(request, done, sent, stage)):
            chunk = sent.popleft()
            self.pace.finish(chunk.rows)
            if journal:
                journal.write(stage, index, chunk, outcome, self.seconds)
            index, done = index + 1, done + chunk.rows
            self._keep_errors(chunk, outcome)
            yield outcome
        if done < request.rows and (self.stopped or not self._has_time_limit):
            raise Interrupted("interrupted")

    def _pieces(self, request: Request, at: int, sent: deque[Request], stage: int) -> Iterator[Request]:
        # A piece of a chunk gives the same bits; a budget of seconds has pieces that fit into the time left.
        most = self._choose_piece_rows(request.rows - at)
        while at < request.rows and not self._should_stop():
            size = min(most, request.rows - at)
            if self._has_time_limit:
                size = self.pace.take(self.seconds, self._time_left, size, first=stage == 0 and at == 0)
            if not size:
                return
            sent.append(request.slice(at, at + size))
            at += size
            yield sent[-1]

    def _choose_piece_rows(self, rows: int) -> int:
        if self.work.problem.named_chunk is not None:
            return self.plan.chunk
        return spread(rows, self.plan.chunk, self.executor.workers)

    def _should_stop(self) -> bool:
        self.stopped = self.stopped or self.stop()
        return self.stopped

    def _can_store(self, request: Request) -> bool:
        return not request.keep_carries or self.estimator.rebuilds_carries

    def _read_journal(self, journal: Journal, stage: int, request: Request) -> Iterator[Rollouts]:
        for index, (chunk, outcome, seconds) in enumerate(journal.read(stage, request)):
            self._check_shape(f"{stage:06d}-{index:06d}", chunk, outcome)
            # A law that was learnt again may differ: check each stage that draws under one.
            if index == 0 and (stage == 0 or chunk.law is not None):
                check_reproduces(self._repeat, chunk, outcome)
            self.began = time.perf_counter() - seconds
            self._keep_errors(chunk, outcome)
            yield outcome

    def _keep_errors(self, chunk: Request, outcome: Rollouts) -> None:
        """Keep the tapes of the first rollouts from the beginning that broke down."""
        most = 10 - len(self.error_tapes)
        if most and outcome.error.any():
            rows = np.flatnonzero(outcome.error & (chunk.start == FROM_START))[:most]
            draw = TapeDrawer(self.work.noise, chunk, self.plan.steps)
            self.error_tapes += list(np.stack([draw(rows, t) for t in range(self.plan.steps + 1)], axis=1))

    def _repeat(self, chunk: Request) -> Rollouts:
        outcome: Rollouts
        (outcome,) = self.executor.map([chunk])
        return outcome

    def _check_shape(self, name: str, chunk: Request, outcome: Rollouts) -> None:
        expected_shape = (chunk.rows, len(self.plan.names)), self.plan.steps + 1 if self.work.scored else 0
        if (outcome.robustness.shape, outcome.scores.shape[1]) != expected_shape:
            hint = "remove this file: its rollouts are then run again"
            raise UsageError(f"{name}.npz of the checkpoint is damaged: it is of another shape", hint)

    @property
    def _has_time_limit(self) -> bool:
        return self.plan.budget is not None and self.plan.budget.kind == "seconds"

    @property
    def _time_left(self) -> float:
        assert self.plan.budget is not None
        return self.plan.budget.amount - self.seconds

    def _out_of_time(self, info: Info) -> bool:
        return self._has_time_limit and bool(info.rollouts) and self._time_left <= 0.0
