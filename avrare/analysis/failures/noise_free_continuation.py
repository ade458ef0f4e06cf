"""Continuations of a failing drive without noise: the moment at which the drive was lost.

A failing tape is run again with its noise ending at one step after another. The last of these rollouts that
keeps the rule shows how long the stack alone could still have saved the drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats
from avrare.rollout.noise_words import format_steps, format_time
from avrare.rollout.problem import Problem


@dataclass(frozen=True)
class Continuations:
    """Rollouts of one tape whose noise ends at K steps; a rollout that breaks down counts as none.

    Attributes:
        steps: (K,) last step with noise, ascending; -1: no noise at all.
        robustness: (K,) of the whole rollout; NaN where it broke down.
        violated: (K,) whether the rule is violated.
        dt: Duration of a step [s]; None where there is none.
        rollouts: Number of rollouts that this took.
    """

    steps: NDArray[np.int64]
    robustness: Floats
    violated: Bools
    dt: float | None
    rollouts: int

    @property
    def lost(self) -> int | None:
        """Step whose noise lost the drive: without it and all that follows the rule is kept.

        None if the drive fails without any noise, or if the rule is kept to the end.
        """
        passing = np.flatnonzero(~self.violated & ~np.isnan(self.robustness))
        if not len(passing) or passing[-1] == len(self.steps) - 1:
            return None
        return int(self.steps[passing[-1]]) + 1

    def describe(self, violation: int | None = None) -> str:
        """Describe the moment; ``violation`` is the sample of the first violation."""
        step = self.lost
        if step is None:
            return self._describe_never()
        before = "at the start" if step == 0 else f"until {format_time(step - 1, self.dt)}"
        text = f"lost at {format_time(step, self.dt)}: with noise only {before} the rule is kept"
        if step == 0:
            text = f"lost at {format_time(0, self.dt)}: without any noise the rule is kept"
        if violation is not None and violation > step:
            text += f"; it is violated {format_steps(violation - step, self.dt)} later"
        return text

    def _describe_never(self) -> str:
        if not (self.violated[-1] or np.isnan(self.robustness[-1])):
            return "it is not lost: the rule is kept"
        if self.violated[0]:
            return "it fails without any noise"
        return "when it was lost is not known: the rollouts with less noise broke down"


def continue_without_noise(problem: Problem, tape: Floats) -> Continuations:
    """Run a tape (steps + 1, noise_size) with its noise ending at one step after another.

    The first specification of ``problem`` is judged.
    """
    ends = np.arange(-1, problem.steps + 1)
    # continuations of a long rollout, at every k-th step; the steps around the moment follow. A kept one
    # between two violated ones is not found then
    most_continuations = 120
    stride = math.ceil(len(ends) / most_continuations)
    chosen = np.unique(np.append(ends[::stride], ends[-1]))
    coarse = _run(problem, tape, chosen)
    if stride > 1 and coarse.lost is not None:
        last = coarse.lost - 1
        following = int(chosen[chosen > last][0])
        fine = _run(problem, tape, np.arange(last + 1, following))
        order = np.argsort(np.append(coarse.steps, fine.steps), kind="stable")
        robustness = np.append(coarse.robustness, fine.robustness)[order]
        violated = np.append(coarse.violated, fine.violated)[order]
        steps = np.append(coarse.steps, fine.steps)[order]
        return Continuations(steps, robustness, violated, coarse.dt, len(order))
    return coarse


def _run(problem: Problem, tape: Floats, ends: NDArray[np.int64]) -> Continuations:
    robustness, violated = [np.zeros(0)], [np.zeros(0, dtype=bool)]
    at = np.arange(len(tape))
    for begin in range(0, len(ends), problem.chunk):
        part = ends[begin : begin + problem.chunk]
        outcome = problem.replay(np.where((at <= part[:, None])[..., None], tape, 0.0))
        robustness.append(np.where(outcome.error, np.nan, outcome.robustness[:, 0]))
        violated.append(outcome.violated[:, 0])
    dt = problem.dt
    return Continuations(ends, np.concatenate(robustness), np.concatenate(violated), dt, len(ends))
