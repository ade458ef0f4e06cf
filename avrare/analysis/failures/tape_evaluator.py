"""Tape evaluator: runs many candidate noise tapes at once within a budget of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request

ProgressCallback = Callable[[str, int], None]
"""Receives the current activity and the number of rollouts so far."""


@dataclass(frozen=True)
class Evaluation:
    """Outcomes of M tapes; a rollout with an error counts neither as a failure nor as a pass."""

    fails: Bools  # (M,) the specification is violated; when passes are sought, it is satisfied
    robustness: Floats  # (M,) sign-flipped when passes are sought; +inf for errors
    score: Floats  # (M,) of the rollout, or minus the robustness unless requested; -inf for errors


class TapeEvaluator:
    """Runs tapes in chunks, up to a budget of rollouts; the first specification of the problem decides.

    With ``seek_pass`` it looks for passes instead of failures.
    """

    def __init__(
        self, problem: Problem, budget: int, progress: ProgressCallback | None = None, seek_pass: bool = False
    ) -> None:
        self.problem = problem
        self.budget = budget
        self.progress = progress
        self.seek_pass = seek_pass
        self.activity = ""
        self.rollouts = 0
        self.errors = 0
        self._norms: list[Floats] = []
        self._fails: list[Bools] = []

    @property
    def remaining(self) -> int:
        """Number of rollouts left in the budget."""
        return max(self.budget - self.rollouts, 0)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of a tape, (steps + 1, noise_size)."""
        return self.problem.steps + 1, self.problem.noise_size

    def smallest_failure(self) -> tuple[float, int]:
        """Return the norm of the smallest failing tape (inf if none), and how many smaller tapes were run."""
        norms, fails = np.concatenate([[], *self._norms]), np.concatenate([[], *self._fails]) > 0
        smallest = float(norms[fails].min(initial=np.inf))
        return smallest, int((norms < smallest).sum())

    def __call__(self, tapes: Iterable[Floats], scored: bool = False) -> Evaluation:
        """Run tapes (steps + 1, noise_size), as many of the first as the budget allows."""
        source = islice(iter(tapes), self.remaining)
        parts = [Evaluation(np.zeros(0, dtype=bool), np.zeros(0), np.zeros(0))]
        while chunk := list(islice(source, self.problem.chunk)):
            tapes = np.stack(chunk)
            parts.append(self._run(tapes, scored))
            self._norms.append(np.sqrt(np.einsum("nsc,nsc->n", tapes, tapes)))
            self._fails.append(parts[-1].fails)
            self.rollouts += len(chunk)
            if self.progress is not None:
                self.progress(self.activity, self.rollouts)
        fields = zip(*((part.fails, part.robustness, part.score) for part in parts), strict=True)
        fails, robustness, score = (np.concatenate(field) for field in fields)
        return Evaluation(fails, robustness, score)

    def _run(self, tapes: Floats, scored: bool) -> Evaluation:
        noise = NoiseSource(0, self.problem.noise_size)
        outcome = self.problem.simulate(noise, Request.replay(tapes), scored=scored)
        self.errors += int(outcome.error.sum())
        robustness, fails = outcome.robustness[:, 0], outcome.violated[:, 0]
        if self.seek_pass:
            robustness, fails = -robustness, ~fails & ~outcome.error
        robustness = np.where(outcome.error, np.inf, robustness)
        score = np.where(outcome.error, -np.inf, outcome.scores[:, -1]) if scored else -robustness
        return Evaluation(fails, robustness, score)
