"""Other planners in the same loop: what failures would be if the planner saw, braked or timed better."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Prediction, Scene
from avrare.protocols import Controller, Floats
from avrare.scenario.timing import Aeb
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.emergency_braking import EmergencyBraking
from avrare.stack.timed_controller import TimedController


class _Seeing(Controller):
    """Controller whose predictions are of the true vehicles."""

    sees_truth = True

    def __init__(self, controller: Controller) -> None:
        self._controller, self.horizon = controller, controller.horizon

    def start(self, n: int) -> Any:
        return self._controller.start(n)

    def act(self, memory: Any, ego: Any, prediction: Prediction | None) -> tuple[Any, Any]:
        return self._controller.act(memory, ego, prediction)

    def counts(self, memory: Any) -> Mapping[str, NDArray[np.int64]]:
        return self._controller.counts(memory)

    def plan(self, memory: Any) -> Floats | None:
        return self._controller.plan(memory)


def list_alternatives(loop: ClosedLoop) -> dict[str, ClosedLoop]:
    """Return the loop with other planners, which read the same tapes, by their behaviour.

    They are those that the controller declares; in driving also one that sees the truth, one with emergency
    braking, and one that knows the delays, where it does not.
    """
    if loop.controller is None:
        return {}
    scene = loop.scene if loop.tracker is None else loop.tracker.known_scene or loop.scene
    controllers = _list_controllers(loop.controller, scene if loop.tracker is not None else None)
    return {f"planner that {name}": loop.controlled_by(each) for name, each in controllers.items()}


def _list_controllers(controller: Controller, scene: Scene | None) -> dict[str, Controller]:
    """Return other controllers; ``scene`` is at the controller's step, None where it has no tracker."""
    sees = "sees the truth"
    if isinstance(controller, TimedController):
        paced = controller.pace(scene)
        inner = _list_controllers(controller.controller, paced)
        if (
            scene is not None and paced is not None and paced.dt != scene.dt
        ):  # the truth is extrapolated at the simulator's step
            inner.pop(sees, None)
        controllers: dict[str, Controller] = {name: controller.around(each) for name, each in inner.items()}
        informed = controller.compensating()
        return controllers if informed is None else {**controllers, "knows the delays": informed}
    controllers = dict(controller.alternatives())
    if scene is not None and not isinstance(controller, EmergencyBraking):
        controllers["has emergency braking"] = EmergencyBraking(controller, Aeb(), scene)
    if scene is not None and not controller.sees_truth:
        controllers[sees] = _Seeing(controller)
    return controllers
