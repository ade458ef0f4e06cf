"""Statistics of repeated estimates, and a problem that counts its rollouts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from avrare.base.special_functions import beta_cdf
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.testing.faulty_systems import Counting
from avrare.testing.reference_problem import ReferenceProblem


@dataclass(frozen=True)
class Study:
    """Estimate to be repeated.

    Attributes:
        problem: Problem with its exact probability.
        repeats: Number of independent repetitions.
        options: Options of the estimator, beside those of the suite.
        seed: Seed of the first repetition.
    """

    problem: ReferenceProblem
    repeats: int = 400
    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


def standard_error(values: Floats) -> float:
    """Return the standard error of the mean of independent ``values`` (R,)."""
    return float(values.std(ddof=1)) / math.sqrt(len(values))


def deviation(values: Floats, truth: float) -> float:
    """Return the distance of the mean of ``values`` (R,) from ``truth`` in standard errors, with its sign."""
    distance = float(values.mean()) - truth
    error = standard_error(values)
    return distance / error if error else math.copysign(math.inf, distance) if distance else 0.0


def coverage_at_most(hits: int, trials: int, coverage: float) -> float:
    """Return P(at most ``hits`` of ``trials`` intervals cover), each with probability ``coverage``."""
    return 1.0 if hits >= trials else beta_cdf(1.0 - coverage, trials - hits, hits + 1)


class Audited(Problem):
    """Problem that counts its rollouts in this process, except for replays.

    Attributes:
        rollouts: Number of starts and branches.
        errors: Number of rollouts that ended in an error.
        stepped: Rows stepped, where the system is a ``Counting`` one.
    """

    rollouts = 0
    errors = 0
    stepped = 0

    def simulate(self, noise: NoiseSource, request: Request, *, scored: bool = True) -> Rollouts:
        """Simulate as ``Problem`` does, and count."""
        before = self._rows_so_far
        outcome = super().simulate(noise, request, scored=scored)
        self.rollouts += request.rows
        self.errors += int(outcome.error.sum())
        self.stepped += self._rows_so_far - before
        return outcome

    @property
    def _rows_so_far(self) -> int:
        return self.system.rows if isinstance(self.system, Counting) else 0

    def replay(self, tape: Floats, *, keep_carries: bool = False) -> Rollouts:
        """Replay as ``Problem`` does: a check of a result costs it nothing."""
        before = self.rollouts, self.errors, self.stepped
        outcome = super().replay(tape, keep_carries=keep_carries)
        self.rollouts, self.errors, self.stepped = before
        return outcome
