"""The smallest disturbance that still fails.

First what is not needed goes (``avrare.failures.reduce``). Where more than a tenth of the norm is left, that
is done again in other orders, since it is greedy; then what is left is turned within its channels, towards
the origin (``avrare.failures.nearest``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.failures.nearest import descend
from avrare.failures.reduce import mixed, reduce
from avrare.failures.trials import Progress, Trials
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem

BUDGET = 3000
"""Rollouts of one shrinking, unless told otherwise."""
ENOUGH = 0.1
"""Share of the norm that should be left at most."""

_RESTARTS = 3
_WORTH = 0.95
"""A turned tape has more numbers; it is taken where it has at most this share of the norm."""
_TRIES = 25


@dataclass(frozen=True)
class Shrunk:
    """A failure and what is left of it.

    Attributes:
        noise: (steps + 1, noise_size) of the shrunk failure.
        before: Norm of the noise at the start.
        after: Norm of what is left.
        numbers: Entries of the noise that are not zero.
        rollouts: That it took.
        reason: Why more than a tenth of the norm is left, or None where it is not.
        rescue: (steps + 1, noise_size) where the rollout without noise fails, so that nothing is left: small
            noise with which it passes, as what is missing without. Else, or where none was found, None.
    """

    noise: Floats
    before: float
    after: float
    numbers: int
    rollouts: int
    reason: str | None
    rescue: Floats | None = None

    @property
    def ratio(self) -> float:
        """Norm after over norm before."""
        return self.after / self.before if self.before > 0.0 else 0.0


def shrink(problem: Problem, tape: Floats, budget: int = BUDGET, progress: Progress | None = None) -> Shrunk:
    """Make the noise of a failure as small as it goes, while it fails.

    Args:
        problem: Whose first specification is violated.
        tape: (steps + 1, noise_size) of the failure.
        budget: Rollouts at most.
        progress: Is told how it goes.

    Raises:
        UsageError: The tape does not fail.
    """
    trials = Trials(problem, budget, progress)
    trials.doing = "shrinking"
    first = trials([tape, np.zeros_like(tape)])
    if not first.fails[:1].any():
        raise UsageError("the rollout does not fail: there is nothing to shrink")
    if first.fails[1:].any():
        rescue = _rescue(problem, trials)
        return Shrunk(np.zeros_like(tape), float(np.linalg.norm(tape)), 0.0, 0, trials.rollouts, None, rescue)
    small = _searched(trials, tape)
    before, after = float(np.linalg.norm(tape)), float(np.linalg.norm(small))
    reason = _reason(trials, before, after)
    return Shrunk(small, before, after, int(np.count_nonzero(small)), trials.rollouts, reason)


def _searched(trials: Trials, tape: Floats) -> Floats:
    """A small failing tape: by one reduction where that is enough, else the best of several searches."""
    enough, budget = ENOUGH * _norm(tape), trials.budget
    small = reduce(trials, tape)
    for number in range(_RESTARTS):
        if _norm(small) <= enough or not trials.left:
            return small
        trials.budget = trials.rollouts + trials.left // (_RESTARTS + 1 - number)
        other = reduce(trials, tape, mixed(number))
        trials.budget = budget
        small = min(small, other, key=_norm)
    if _norm(small) <= enough or not trials.left:
        return small
    turned = descend(trials, small, within=np.asarray(small.any(axis=0)))
    return turned if _norm(turned) <= max(_WORTH * _norm(small), enough) else small


def _norm(tape: Floats) -> float:
    return float(np.linalg.norm(tape))


def _reason(trials: Trials, before: float, after: float) -> str | None:
    if after <= ENOUGH * before:
        return None
    least, smaller = trials.least()
    tried = f"{smaller} tapes below {least:.2g} were tried, none fails"
    found = f"a tenth is a norm of {ENOUGH * before:.2g}; {tried}"
    return found if trials.left else f"{found}; the budget of rollouts is spent"


def _rescue(problem: Problem, trials: Trials) -> Floats | None:
    """A small tape that passes, from the first random one that does."""
    passing = Trials(problem, trials.left, trials.progress, passing=True)
    passing.doing = "looking for what passes"
    noise = NoiseSource(0, problem.noise_size)
    steps = np.arange(problem.steps + 1)
    tapes = [noise.normals(0, 0, particle, steps) for particle in range(_TRIES)]
    passes = np.flatnonzero(passing(tapes).fails)
    small = reduce(passing, tapes[int(passes[0])]) if len(passes) else None
    trials.rollouts += passing.rollouts
    return small
