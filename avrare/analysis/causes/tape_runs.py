"""Runs of given noise tapes, chunk by chunk, on one process or several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.executors.work import Executor, Work, build_executor
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request

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
            np.concatenate(none + [one.fails for one in parts]),
            np.concatenate(none + [one.broken for one in parts]),
        )


@dataclass
class TapeRunner:
    """Runner of tapes that counts its rollouts and errors.

    Attributes:
        workers: Number of processes.
        watch: Called after each chunk.
        rollouts: Rollouts so far.
        errors: Those that broke down; they count neither as failures nor as passes.
    """

    workers: int = 1
    watch: Watch | None = None
    rollouts: int = 0
    errors: int = 0

    def __call__(self, problem: Problem, tapes: Floats, activity: str = "") -> Verdicts:
        """Return the outcomes of the first specification of ``problem`` on ``tapes``."""
        rows = problem.chunk
        requests = (Request.replay(tapes[at : at + rows]) for at in range(0, len(tapes), rows))
        executor: Executor = build_executor(self.workers)
        executor.open(Work(problem, NoiseSource(0, problem.noise_size), scored=False))
        found = []
        with closing(executor):
            for outcome in executor.map(requests):
                found.append(Verdicts(outcome.violated[:, 0], outcome.error))
                self.rollouts += len(outcome.error)
                self.errors += int(outcome.error.sum())
                if self.watch is not None:
                    self.watch(activity, self.rollouts)
        return Verdicts.join(found)


def draw_tapes(problem: Problem, seed: int, stage: int, count: int, first: int = 0) -> Floats:
    """Draw fresh tapes (count, steps + 1, noise_size); seed, stage and number decide each."""
    noise = NoiseSource(seed, problem.noise_size)
    rows = first + np.arange(count)[:, None]
    return noise.normals(0, stage, rows, np.arange(problem.steps + 1))
