"""Plans by CasADi's solvers, one particle after another: the reference."""

from __future__ import annotations

import numpy as np

from avrare.driving import Scene
from avrare_mpc.config import MpcConfig
from avrare_mpc.lanes import lane_centres
from avrare_mpc.plan import Bools, Floats, from_variables, to_variables
from avrare_mpc.problem import build_problem, pack_parameters
from avrare_mpc.search import Outcome, cheapest
from avrare_mpc.solver import NlpSolver
from avrare_mpc.start_policy import start_drives


class CasadiSearch:
    """A ``Search`` by fatrop, and by ipopt where that fails.

    Args:
        config: Options.
        scene: Road and sizes.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self._scene, self._horizon = scene, config.horizon
        self._everywhere = config.search == "everywhere"
        self._centres = lane_centres(config, scene)
        self._solver = NlpSolver(build_problem(config, scene), config.solver)

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> Outcome:
        """See ``Search``."""
        parameters = pack_parameters(self._scene, start, *others)
        warm = to_variables(*old)
        guesses = list(warm[:, None])
        looking = np.flatnonzero(~solved | self._everywhere)
        drives = start_drives(start[looking], self._centres, self._horizon, self._scene.dt)
        for row, fresh in zip(looking.tolist(), to_variables(*drives), strict=True):
            guesses[row] = np.concatenate([guesses[row], fresh]) if solved[row] else fresh
        rows = [self._search_row(several, given) for several, given in zip(guesses, parameters, strict=True)]
        variables = np.array([row[0] for row in rows]).reshape(warm.shape)
        solves, retries, chosen = np.array([row[1:] for row in rows], dtype=np.int64).reshape(-1, 3).T
        states, inputs = from_variables(variables)
        return Outcome(states, inputs, chosen >= 0, solves, retries, chosen)

    def _search_row(self, guesses: Floats, parameters: Floats) -> tuple[Floats, int, int, int]:
        """The cheapest plan from ``guesses`` (G, 8 H + 5), solves, retries, and which guess it was."""
        solutions = [self._solver.solve(guess, parameters) for guess in guesses]
        chosen = int(cheapest(np.array([[solution.cost for solution in solutions]]))[0])
        found = solutions[chosen].variables if chosen >= 0 else None
        retries = sum(solution.retried for solution in solutions)
        return np.zeros_like(guesses[0]) if found is None else found, len(guesses), retries, chosen
