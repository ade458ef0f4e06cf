"""Runs of given noise tapes, chunk by chunk, on one process or several; a journal keeps finished chunks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Journal
from avrare.protocols import Bools, Floats
from avrare.rollout.executors.work import Executor, Work, build_executor, check_reproduces
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts

Watch = Callable[[str, int], None]
"""Receives the current activity and the number of rollouts so far."""


@dataclass(frozen=True)
class Verdicts:
    """Outcomes of N tapes.

    Attributes:
        fails: (N,) True where the specification is violated; False where the rollout broke down.
        broken: (N,) True where the rollout broke down: it neither fails nor passes.
    """

    fails: Bools
    broken: Bools

    @property
    def passes(self) -> Bools:
        """(N,) True where the rollout ended and violates nothing."""
        return ~self.fails & ~self.broken

    @staticmethod
    def join(parts: Sequence[Verdicts]) -> Verdicts:
        """Join the outcomes of consecutive tapes."""
        none = [np.zeros(0, dtype=bool)]
        return Verdicts(
            np.concatenate(none + [verdicts.fails for verdicts in parts]),
            np.concatenate(none + [verdicts.broken for verdicts in parts]),
        )


@dataclass
class TapeRunner:
    """Runner of tapes that counts its rollouts and errors.

    Attributes:
        workers: Number of processes.
        watch: Called after each chunk.
        rollouts: Rollouts so far.
        errors: Those that broke down; they count neither as failures nor as passes.
        journal: Keeps the outcomes of finished chunks; those of an equal task are not run again.
        calls: Calls so far, each a stage of the journal.
    """

    workers: int = 1
    watch: Watch | None = None
    rollouts: int = 0
    errors: int = 0
    journal: Journal | None = None
    calls: int = 0

    def __call__(self, problem: Problem, tapes: Floats, activity: str = "") -> Verdicts:
        """Return the outcomes of the first specification of ``problem`` on ``tapes``."""
        stage, self.calls = self.calls, self.calls + 1
        work, verdicts = Work(problem, NoiseSource(0, problem.noise_size), scored=False), []
        for outcome in self._outcomes(stage, work, tapes):
            verdicts.append(Verdicts(outcome.violated[:, 0], outcome.error))
            self.rollouts += len(outcome.error)
            self.errors += int(outcome.error.sum())
            if self.watch is not None:
                self.watch(activity, self.rollouts)
        return Verdicts.join(verdicts)

    def keep(self, tapes: Floats, measure: Callable[[], Floats]) -> Floats:
        """Measure each tape (a number); the journal keeps the numbers.

        Raises:
            UsageError: The first thing that the journal holds is measured again, and differs.
        """
        stage, self.calls = self.calls, self.calls + 1
        if self.journal is None:
            return measure()
        chunk = Request.replay(tapes)
        for stored in self.journal.read(stage, chunk):
            values = stored.outcome.log_weight
            if stage == 0 and not np.array_equal(measure(), values, equal_nan=True):
                hint = "the code or its libraries have changed: restore them, or choose another folder"
                raise UsageError("saved density ratios do not reproduce", hint)
            return values
        values, rows = measure(), len(tapes)
        nothing = np.zeros((rows, 1))
        outcome = Rollouts(
            nothing, nothing > 0.0, np.zeros(rows, dtype=bool), nothing[:, :0], 0, log_weight=values
        )
        self.journal.write(stage, 0, chunk, outcome, 0.0)
        return values

    def _outcomes(self, stage: int, work: Work, tapes: Floats) -> Iterator[Rollouts]:
        request, rows, index, done = Request.replay(tapes), work.problem.chunk, 0, 0
        for stored in self.journal.read(stage, request) if self.journal is not None else ():
            if index == 0:  # each call may have a problem of its own
                check_reproduces(work.run, stored.request, stored.outcome)
            index, done = index + 1, done + stored.request.rows
            yield stored.outcome
        chunks = [request.slice(at, at + rows) for at in range(done, len(tapes), rows)]
        if not chunks:
            return
        executor: Executor = build_executor(min(self.workers, len(chunks)))
        executor.open(work)
        with closing(executor):
            for number, (chunk, outcome) in enumerate(zip(chunks, executor.map(chunks), strict=True), index):
                if self.journal is not None:
                    self.journal.write(stage, number, chunk, outcome, 0.0)
                yield outcome


def draw_tapes(problem: Problem, seed: int, stage: int, count: int, first: int = 0) -> Floats:
    """Draw fresh tapes (count, steps + 1, noise_size); seed, stage and number decide each."""
    noise = NoiseSource(seed, problem.noise_size)
    rows = first + np.arange(count)[:, None]
    return noise.normals(0, stage, rows, np.arange(problem.steps + 1))
