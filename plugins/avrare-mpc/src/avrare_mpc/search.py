"""What the controller asks of a backend: plans for many particles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from avrare_mpc.plan import Bools, Floats, Integers

TIE = 1e-6
"""Plans whose costs differ by less, relatively, are the same minimum: the first one is kept."""


@dataclass(frozen=True)
class Outcome:
    """What the solver did with N particles; plans are meaningless where not ``found``.

    Attributes:
        states: (N, H + 1, 4).
        inputs: (N, H, 2).
        found: (N,) there is a plan.
        solves: (N,) programmes handed to a solver.
        retries: (N,) how many of them the first attempt failed on.
        chosen: (N,) which guess gave the plan; -1 where there is none.
    """

    states: Floats
    inputs: Floats
    found: Bools
    solves: Integers
    retries: Integers
    chosen: Integers


class Search(Protocol):
    """Finds the plans of N particles; a row's plan does not depend on the other rows."""

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> Outcome:
        """The cheapest plan of each particle.

        Args:
            solved: (N,) search from the old plan; elsewhere from the start drives.
            start: (N, 4) x, y, speed, heading now.
            old: States (N, H + 1, 4) and inputs (N, H, 2) of the old plans, one step on.
            others: Predicted x and y, each (N, V, H + 1) [m].
        """
        ...


def cheapest(cost: Floats) -> NDArray[np.int64]:
    """The first of the least costs (N, G), up to ties; infinite costs are no plans, -1 where all are."""
    best = np.full(len(cost), np.inf)
    chosen = np.full(len(cost), -1, dtype=np.int64)
    for index, candidate in enumerate(cost.T):
        margin = np.where(chosen >= 0, TIE * np.abs(np.where(chosen >= 0, best, 0.0)), 0.0)
        better = candidate < best - margin
        best = np.where(better, candidate, best)
        chosen = np.where(better, index, chosen)
    return chosen
