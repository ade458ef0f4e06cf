"""Plans by the structured interior-point method, all particles in one call."""

from __future__ import annotations

import numpy as np

from avrare.driving import Scene
from avrare_mpc.config import MpcConfig
from avrare_mpc.lanes import lane_centres
from avrare_mpc.plan import Bools, Floats, Integers
from avrare_mpc.riccati.solver import RiccatiSolver, Solutions
from avrare_mpc.search import Outcome, cheapest
from avrare_mpc.start_policy import start_drives

FARTHEST = 1e9
"""Positions and speeds beyond this are not solved for: their squares would drown everything else."""


class RiccatiSearch:
    """A ``Search`` by ``RiccatiSolver``.

    Args:
        config: Options.
        scene: Road and sizes.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self._centres = lane_centres(config, scene)
        self._steps, self._dt = config.horizon, scene.dt
        self._solver = RiccatiSolver(config, scene)
        self._everywhere = config.search == "everywhere"

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> Outcome:
        """See ``Search``."""
        n = len(solved)
        fresh, drives = np.flatnonzero(~solved), self._drives(start[~solved])
        # A table of programmes: row of the particle, number of the guess, its inputs.
        rows = np.concatenate([np.flatnonzero(solved), np.repeat(fresh, drives.shape[1])])
        numbers = np.concatenate(
            [np.zeros(solved.sum(), int), np.tile(np.arange(drives.shape[1]), len(fresh))]
        )
        guesses = np.concatenate([old[1][solved], drives.reshape(-1, self._steps, 2)])
        sane = _sane(start, *others)[rows] & np.isfinite(guesses).all(axis=(1, 2))
        solution = self._solver.solve(start, *others, rows[sane], guesses[sane])
        looked = self._look_around(solution, start, others, rows[sane], solved)
        cost = np.full((n, drives.shape[1]), np.inf)
        place = np.full(cost.shape, -1)
        cost[rows[sane], numbers[sane]] = np.where(solution.found, solution.cost, np.inf)
        place[rows[sane], numbers[sane]] = np.arange(sane.sum())
        chosen = cheapest(cost)
        found = chosen >= 0
        states, inputs = np.zeros((n, self._steps + 1, 4)), np.zeros((n, self._steps, 2))
        taken = place[found, chosen[found]]
        states[found], inputs[found] = solution.states[taken], solution.inputs[taken]
        retries = np.bincount(rows[sane][solution.retried], minlength=n)
        solves = np.bincount(rows, minlength=n) + np.bincount(looked, minlength=n)
        return Outcome(states, inputs, found, solves, retries, chosen)

    def _look_around(
        self, solution: Solutions, start: Floats, others: tuple[Floats, Floats], rows: Integers, solved: Bools
    ) -> Integers:
        """Search from the start drives too where only the old plan was; the row of each such search."""
        index = np.flatnonzero(solved[rows] & self._everywhere)
        drives = self._drives(start[rows[index]])
        for number in range(drives.shape[1] if len(index) else 0):
            self._solver.improve(solution, index, start, *others, rows[index], drives[:, number])
        return np.repeat(rows[index], drives.shape[1])

    def _drives(self, start: Floats) -> Floats:
        """Inputs (N, G, H, 2) of the start drives."""
        with np.errstate(invalid="ignore"):
            return start_drives(start, self._centres, self._steps, self._dt)[1]


def _sane(start: Floats, other_x: Floats, other_y: Floats) -> Bools:
    """(N,) rows without NaN, infinity or absurd numbers."""
    others = (np.abs(other_x) <= FARTHEST) & (np.abs(other_y) <= FARTHEST)
    return np.asarray((np.abs(start) <= FARTHEST).all(axis=1) & others.all(axis=(1, 2)))
