"""Lane-change model-predictive controller: one programme for each particle and step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.errors import UsageError
from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import Bools, Floats, Memory, empty_memory, shift
from avrare_mpc.search import Search


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
        self._search = _backend(config, scene)

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
        others = self._predicted(prediction)
        old = shift(memory.plan_states, memory.plan_inputs, self._scene.dt)
        outcome = self._search(memory.solved, start, old, others)
        found = outcome.found
        states = np.where(found[:, None, None], outcome.states, old[0])
        inputs = np.where(found[:, None, None], outcome.inputs, old[1])
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

    def _action(self, planned: Bools, first: Floats, speed: Floats) -> Action:
        limit = self._config.acceleration_max
        stopping = np.nan_to_num(-speed / self._scene.dt, nan=-limit)
        return Action(
            acceleration=np.where(planned, first[:, 0], np.clip(stopping, -limit, limit)),
            yaw_rate=np.where(planned, first[:, 1], 0.0),
        )


def _backend(config: MpcConfig, scene: Scene) -> Search:
    """Imported where it is chosen: each backend brings its own compiler."""
    if config.backend == "riccati":
        from avrare_mpc.riccati.search import RiccatiSearch

        return RiccatiSearch(config, scene)
    from avrare_mpc.casadi_search import CasadiSearch

    return CasadiSearch(config, scene)


def build(config: MpcConfig, scene: Scene) -> MpcController:
    """The controller of a scenario; compiles the programme."""
    return MpcController(config, scene)
