"""Looking for a failure, then for the most likely one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.failures.climb import climb
from avrare.failures.nearest import nearest
from avrare.failures.trials import Progress, Trials
from avrare.protocols import Floats
from avrare.rollout.problem import Problem

BUDGET = 4000
"""Rollouts of one search, unless told otherwise."""
_STARTS = 2
"""So many failures the second search starts from, those of the smallest norm."""


@dataclass(frozen=True)
class Falsified:
    """What a search found.

    Attributes:
        noise: (steps + 1, noise_size) of the most likely failure found, or None.
        norm: Of it; inf where there is none.
        first: Norm of the first failure found; inf where there is none.
        until_first: Rollouts until then, or all of them.
        rollouts: In all.
        errors: Rollouts that broke down.
        finished: The search came to its end within the budget, from every failure that it started from.
    """

    noise: Floats | None
    norm: float
    first: float
    until_first: int
    rollouts: int
    errors: int
    finished: bool


def falsify(
    problem: Problem, seed: int = 0, budget: int = BUDGET, progress: Progress | None = None
) -> Falsified:
    """Find a failure of the first specification, and then the one with the smallest norm.

    Both are searches, not estimates: nothing is said of probabilities, and a smaller failure may exist.

    Args:
        problem: To break.
        seed: The same seed finds the same failure.
        budget: Rollouts at most.
        progress: Is told how it goes.
    """
    trials = Trials(problem, budget, progress)
    trials.doing, zeros = "driving without noise", np.zeros(trials.shape)
    if trials([zeros]).fails.any():
        return Falsified(zeros, 0.0, 0.0, 1, 1, trials.errors, True)
    starts = climb(trials, seed)[:_STARTS]
    until = trials.rollouts
    if not starts:
        return Falsified(None, np.inf, np.inf, until, until, trials.errors, False)
    found, finished = [starts[0]], True
    for k, start in enumerate(starts):
        trials.budget = trials.rollouts + (budget - trials.rollouts) // (len(starts) - k)
        if trials.left:
            found.append(nearest(trials, start, seed + k))
        finished &= trials.left > 0
    best = min(found, key=lambda tape: float(np.linalg.norm(tape)))
    first = float(np.linalg.norm(starts[0]))
    norm = float(np.linalg.norm(best))
    return Falsified(best, norm, first, until, trials.rollouts, trials.errors, finished)
