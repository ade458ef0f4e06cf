"""Trying out many noise tapes at once, within a budget of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request

Progress = Callable[[str, int], None]
"""Is told what is being done and how many rollouts there were."""


@dataclass(frozen=True)
class Tried:
    """What came of M tapes; one that broke down is neither a failure nor a pass.

    Attributes:
        fails: (M,) the specification is violated; where passes are looked for, it is not.
        robustness: (M,) negated where passes are looked for; +inf where it broke down.
        score: (M,) how near to failure it came, -inf where it broke down; robustness negated unless asked.
        errors: How many broke down.
    """

    fails: Bools
    robustness: Floats
    score: Floats
    errors: int


class Trials:
    """Runs tapes in chunks and counts them.

    Args:
        problem: Whose first specification is to fail.
        budget: Rollouts; tapes beyond are not run.
        progress: Called after each chunk.
        passing: Look for passes in place of failures.
    """

    def __init__(
        self, problem: Problem, budget: int, progress: Progress | None = None, passing: bool = False
    ) -> None:
        self.problem = problem
        self.budget = budget
        self.rollouts = 0
        self.errors = 0
        self.doing = ""
        self.passing = passing
        self._norms: list[Floats] = []
        self._failed: list[Bools] = []
        self.progress = progress

    @property
    def left(self) -> int:
        """Rollouts that are left."""
        return max(self.budget - self.rollouts, 0)

    def least(self) -> tuple[float, int]:
        """Norm of the smallest tape that failed (inf: none did), and how many smaller ones were run."""
        norms, fails = np.concatenate([[], *self._norms]), np.concatenate([[], *self._failed]) > 0
        least = float(norms[fails].min(initial=np.inf))
        return least, int((norms < least).sum())

    @property
    def shape(self) -> tuple[int, int]:
        """Of a tape."""
        return self.problem.steps + 1, self.problem.noise_size

    def __call__(self, tapes: Iterable[Floats], scored: bool = False) -> Tried:
        """Run tapes (steps + 1, noise_size), the first of them where the budget does not reach for all."""
        source = islice(iter(tapes), self.left)
        parts = []
        while chunk := list(islice(source, self.problem.chunk)):
            tapes = np.stack(chunk)
            parts.append(self._run(tapes, scored))
            self._norms.append(np.sqrt(np.einsum("nsc,nsc->n", tapes, tapes)))
            self._failed.append(parts[-1].fails)
            self.rollouts += len(chunk)
            if self.progress is not None:
                self.progress(self.doing, self.rollouts)
        self.errors += sum(part.errors for part in parts)
        if not parts:
            return Tried(np.zeros(0, dtype=bool), np.zeros(0), np.zeros(0), 0)
        names = ("fails", "robustness", "score")
        joined = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
        return Tried(joined[0], joined[1], joined[2], sum(part.errors for part in parts))

    def _run(self, tapes: Floats, scored: bool) -> Tried:
        noise = NoiseSource(0, self.problem.noise_size)
        outcome = self.problem.simulate(noise, Request.replay(tapes), scored=scored)
        robustness, fails = outcome.robustness[:, 0], outcome.violated[:, 0]
        if self.passing:
            robustness, fails = -robustness, ~fails & ~outcome.error
        robustness = np.where(outcome.error, np.inf, robustness)
        score = np.where(outcome.error, -np.inf, outcome.scores[:, -1]) if scored else -robustness
        return Tried(fails, robustness, score, int(outcome.error.sum()))
