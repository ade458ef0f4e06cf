"""Lane-change model-predictive controller: one programme for each particle and step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.errors import UsageError
from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import Bools, Floats, Integers, Memory, empty_memory, from_variables, shift, to_variables
from avrare_mpc.problem import build_problem, lane_centres, pack_parameters
from avrare_mpc.solver import NlpSolver
from avrare_mpc.start_policy import start_drives

TIE = 1e-6
"""Plans whose costs differ by less, relatively, are the same minimum: the first one is kept."""


@dataclass(frozen=True)
class _Outcome:
    """What the solver did with N particles: ``variables`` are zeros where not ``found``."""

    variables: Floats
    found: Bools
    solves: Integers
    retries: Integers
    chosen: Integers


class MpcController:
    """Plans H steps ahead around the predicted others and acts on the first input.

    A plan is searched from the last one, one step on; the first plan from each of the start drives
    (``avrare_mpc.start_policy``), where the cheapest result counts. A failed search is counted, never raised:
    the particle drives on along its old plan and, where that has ended, brakes straight ahead.

    Args:
        config: Options.
        scene: Road and sizes.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self.horizon = config.horizon
        self._config = config
        self._scene = scene
        self._centres = lane_centres(config, scene)
        self._solver = NlpSolver(build_problem(config, scene), config.solver)

    def start(self, n: int) -> Memory:
        """Memory of ``n`` particles without a plan."""
        return empty_memory(n, self.horizon)

    def act(self, memory: Memory, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Memory]:
        """The first input of each particle's new plan.

        Args:
            memory: Plans and counters.
            ego: State now, fields (N,).
            prediction: The others, at least H + 1 entries.

        Raises:
            UsageError: There is no prediction, or it is too short.
        """
        start = np.stack([ego.x, ego.y, ego.speed, ego.heading], axis=1)
        parameters = pack_parameters(self._scene, start, *self._predicted(prediction))
        old_states, old_inputs = shift(memory.plan_states, memory.plan_inputs, self._scene.dt)
        outcome = self._search(memory.solved, start, to_variables(old_states, old_inputs), parameters)
        found = outcome.found
        states, inputs = from_variables(outcome.variables)
        states = np.where(found[:, None, None], states, old_states)
        inputs = np.where(found[:, None, None], inputs, old_inputs)
        age = np.where(found, 0, memory.age + 1)
        solved = found | (memory.solved & (age < self.horizon))
        first_plan = found & ~memory.solved
        later = Memory(
            plan_states=states,
            plan_inputs=inputs,
            solved=solved,
            age=age,
            solves=memory.solves + outcome.solves,
            retries=memory.retries + outcome.retries,
            fallbacks=memory.fallbacks + ~found,
            start_policy=np.where(first_plan, outcome.chosen, memory.start_policy),
        )
        return self._action(solved, inputs[:, 0], ego.speed), later

    def counts(self, memory: Memory) -> dict[str, NDArray[np.int64]]:
        """Counters to report, each (N,)."""
        return {
            "solves": memory.solves,
            "solver_retries": memory.retries,
            "fallback_solves": memory.fallbacks,
        }

    def _predicted(self, prediction: Prediction | None) -> tuple[Floats, Floats]:
        if prediction is None:
            raise UsageError("the controller mpc needs predictions", hint="name a tracker in the scenario")
        nodes = self.horizon + 1
        if prediction.x.shape[2] < nodes:
            raise UsageError(f"the controller mpc needs {self.horizon} predicted steps")
        return prediction.x[:, :, :nodes], prediction.y[:, :, :nodes]

    def _search(self, solved: Bools, start: Floats, warm: Floats, parameters: Floats) -> _Outcome:
        """Solve row by row; a row's result does not depend on the other rows."""
        n = len(solved)
        guesses = list(warm[:, None])
        drives = start_drives(start[~solved], self._centres, self.horizon, self._scene.dt)
        for row, fresh in zip(np.flatnonzero(~solved).tolist(), to_variables(*drives), strict=True):
            guesses[row] = fresh
        outcome = _Outcome(
            variables=np.zeros_like(warm),
            found=np.zeros(n, dtype=np.bool_),
            solves=np.zeros(n, dtype=np.int64),
            retries=np.zeros(n, dtype=np.int64),
            chosen=np.full(n, -1, dtype=np.int64),
        )
        for row, several in enumerate(guesses):
            self._search_row(outcome, row, several, parameters[row])
        return outcome

    def _search_row(self, outcome: _Outcome, row: int, guesses: Floats, parameters: Floats) -> None:
        """Fill one row of ``outcome`` with the cheapest plan found from ``guesses`` (G, 8 H + 5)."""
        cheapest, margin = np.inf, 0.0
        for index, guess in enumerate(guesses):
            solution = self._solver.solve(guess, parameters)
            outcome.solves[row] += 1
            outcome.retries[row] += solution.retried
            if solution.variables is not None and solution.cost < cheapest - margin:
                cheapest, margin = solution.cost, TIE * abs(solution.cost)
                outcome.variables[row] = solution.variables
                outcome.found[row] = True
                outcome.chosen[row] = index

    def _action(self, planned: Bools, first: Floats, speed: Floats) -> Action:
        limit = self._config.acceleration_max
        stopping = np.nan_to_num(-speed / self._scene.dt, nan=-limit)
        return Action(
            acceleration=np.where(planned, first[:, 0], np.clip(stopping, -limit, limit)),
            yaw_rate=np.where(planned, first[:, 1], 0.0),
        )


def build(config: MpcConfig, scene: Scene) -> MpcController:
    """The controller of a scenario; compiles the programme."""
    return MpcController(config, scene)
