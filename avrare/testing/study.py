"""Statistics of repeated estimates, and a problem that keeps the books."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from avrare.estimation.intervals import beta_cdf
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.testing.problem import ReferenceProblem


@dataclass(frozen=True)
class Study:
    """An estimate to be repeated.

    Attributes:
        problem: With its exact probability.
        repeats: Independent repetitions.
        options: Of the estimator, beside those of the suite.
        seed: Of the first repetition.
    """

    problem: ReferenceProblem
    repeats: int = 400
    options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0


def standard_error(values: Floats) -> float:
    """Of the mean of independent ``values`` (R,)."""
    return float(values.std(ddof=1)) / math.sqrt(len(values))


def deviation(values: Floats, truth: float) -> float:
    """Distance of the mean of ``values`` (R,) from ``truth`` in standard errors, negative below it."""
    distance = float(values.mean()) - truth
    error = standard_error(values)
    return distance / error if error else math.copysign(math.inf, distance) if distance else 0.0


def coverage_at_most(hits: int, trials: int, coverage: float) -> float:
    """P(at most ``hits`` of ``trials`` intervals cover), if each does so with probability ``coverage``."""
    return 1.0 if hits >= trials else beta_cdf(1.0 - coverage, trials - hits, hits + 1)


class Audited(Problem):
    """A problem that counts, in this process, what it is asked for.

    Attributes:
        rollouts: Starts and branches.
        broken: Rollouts that broke down.
    """

    rollouts = 0
    broken = 0

    def simulate(self, noise: NoiseSource, request: Request, *, scored: bool = True) -> Rollouts:
        """As ``Problem.simulate``."""
        outcome = super().simulate(noise, request, scored=scored)
        self.rollouts += request.rows
        self.broken += int(outcome.error.sum())
        return outcome
