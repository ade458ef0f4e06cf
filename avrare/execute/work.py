"""A chunk of work, and what an executor does with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts


@dataclass(frozen=True)
class Work:
    """What all chunks of an estimate share.

    Attributes:
        problem: Must survive pickling to leave the process.
        noise: Where the tapes come from.
        scored: Whether the estimator needs the importance score.
    """

    problem: Problem
    noise: NoiseSource
    scored: bool

    def run(self, chunk: Request) -> Rollouts:
        """The outcome of one chunk; the same wherever it runs."""
        return self.problem.simulate(self.noise, chunk, scored=self.scored)


class Executor(Protocol):
    """An ordered map over chunks."""

    def open(self, work: Work) -> None:
        """Prepare the workers for chunks of ``work``."""

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Outcomes in the order of the chunks; takes a chunk no sooner than there is room for it."""

    def close(self) -> None:
        """Stop the workers."""
