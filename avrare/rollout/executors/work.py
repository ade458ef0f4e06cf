"""Work of an executor."""

from __future__ import annotations

from dataclasses import dataclass

from avrare import protocols
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts


@dataclass(frozen=True)
class Work:
    """Work that all chunks of an estimate share.

    Attributes:
        problem: Problem to simulate; must survive pickling to reach another process.
        noise: Source of the noise tapes.
        scored: True where the estimator needs the importance score.
    """

    problem: Problem
    noise: NoiseSource
    scored: bool

    def run(self, chunk: Request) -> Rollouts:
        """Return the outcome of one chunk; the same wherever it runs."""
        return self.problem.simulate(self.noise, chunk, scored=self.scored)


Executor = protocols.Executor[Work, Request, Rollouts]
"""Executor of chunks of rollouts."""
