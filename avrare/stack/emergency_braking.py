"""Automatic emergency braking around any driving controller: a fallback that overrides its acceleration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.protocols import Bools, Controller, Floats, adapt
from avrare.scenario.timing import Aeb


@dataclass(frozen=True)
class BrakeMemory:
    """Memory of a controller with emergency braking.

    Attributes:
        planner: Memory of the controller itself.
        active: (N,) whether it has decided to brake.
        since: (N,) time since it has decided [s].
        level: (N,) deceleration that it asks for [m/s^2].
        interventions: (N,) how often it has begun to brake.
    """

    planner: Any
    active: Bools
    since: Floats
    level: Floats
    interventions: NDArray[np.int64]


def add_emergency_braking(
    controller: Controller | None, options: Aeb, scene: Scene | None
) -> EmergencyBraking:
    """Return a controller that brakes in emergencies and otherwise drives as the given one.

    Raises:
        UsageError: The controller or the road is missing.
    """
    if controller is None:
        raise UsageError("the stack has no controller", "add a `controller:` block, or remove `aeb:`")
    if scene is None:
        raise UsageError("it needs a driving simulator", "remove the block `aeb:`")
    return EmergencyBraking(controller, options, scene)


class EmergencyBraking(Controller):
    """Controller that brakes as ``Aeb`` says for a vehicle in its way that the tracker knows of.

    It continues until nothing in the way comes nearer; the controller steers all the time.

    Args:
        controller: The controller itself.
        options: When it begins, and how it brakes.
        scene: Sizes of the vehicles and the step.
    """

    def __init__(self, controller: Controller, options: Aeb, scene: Scene) -> None:
        self._controller, self._options, self._scene = adapt(Controller, controller), options, scene
        self.horizon = max(controller.horizon, 1)
        self.sees_truth = controller.sees_truth

    def start(self, n: int) -> BrakeMemory:
        """Return the memory of ``n`` particles before the first step."""
        zeros = np.zeros(n)
        return BrakeMemory(
            self._controller.start(n), zeros.astype(bool), zeros, zeros, zeros.astype(np.int64)
        )

    def act(
        self, memory: BrakeMemory, ego: Vehicles, prediction: Prediction | None
    ) -> tuple[Action, BrakeMemory]:
        """Return the controller's action, braked where it has to be, and the memory after it."""
        action, planner = self._controller.act(memory.planner, ego, prediction)
        if prediction is None:
            raise UsageError("aeb: needs predictions", "name a tracker in the scenario")
        options, dt = self._options, self._scene.dt
        dangerous, nearing = self._judge(ego, prediction)
        active = dangerous | (memory.active & nearing)
        since = np.where(active & memory.active, memory.since + dt, 0.0)
        braking = np.minimum((since - options.delay + dt) * options.ramp, options.deceleration)
        level = np.where(active & (since >= options.delay - 1e-9), braking, 0.0)
        stopping = np.maximum(-level, np.minimum(-ego.speed / dt, 0.0))
        acceleration = np.where(level > 0.0, np.minimum(action.acceleration, stopping), action.acceleration)
        interventions = memory.interventions + ((level > 0.0) & (memory.level == 0.0))
        return replace(action, acceleration=acceleration), BrakeMemory(
            planner, active, since, level, interventions
        )

    def alternatives(self) -> dict[str, Controller]:
        """Return the alternatives of the controller with the same braking, and one that brakes earlier."""
        options = self._options
        earlier = 2.0
        begin = {
            "time_to_collision": options.time_to_collision and earlier * options.time_to_collision,
            "needed_deceleration": options.needed_deceleration and options.needed_deceleration / earlier,
        }
        variants = {name: (each, options) for name, each in self._controller.alternatives().items()}
        variants["begins emergency braking earlier"] = self._controller, options.model_copy(update=begin)
        return {name: EmergencyBraking(*each, self._scene) for name, each in variants.items()}

    def counts(self, memory: BrakeMemory) -> Mapping[str, NDArray[np.int64]]:
        """Return the counters of the controller itself, and ``aeb_interventions``."""
        return {**self._controller.counts(memory.planner), "aeb_interventions": memory.interventions}

    def plan(self, memory: BrakeMemory) -> Floats | None:
        """Return the plan of the controller itself."""
        return self._controller.plan(memory.planner)

    def features(self, memory: BrakeMemory) -> Floats | None:
        """Return the features of the controller itself."""
        return self._controller.features(memory.planner)

    def _judge(self, ego: Vehicles, prediction: Prediction) -> tuple[Bools, Bools]:
        """Return (N,) whether a vehicle in the way demands braking, and whether one comes nearer."""
        options, scene = self._options, self._scene
        x, y = prediction.x[:, :, 0], prediction.y[:, :, 0]
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):  # vehicles at infinity
            speeds = ((part[:, :, 1] - part[:, :, 0]) / scene.dt for part in vars(prediction).values())
            along, across = speeds
            gap = np.maximum(x - ego.x[:, None] - 0.5 * (scene.lengths + scene.ego_length), 0.0)
            closing = (ego.speed * np.cos(ego.heading))[:, None] - along
            time = np.where(closing > 0.0, gap / closing, np.inf)
            sideways = (ego.speed * np.sin(ego.heading))[:, None]
            # courses extend over 10 s at most
            aside = np.abs(y - ego.y[:, None] + (across - sideways) * np.minimum(time, 10.0))
            touches = aside < 0.5 * (scene.widths + scene.ego_width) + options.side_room
            in_way = (x > ego.x[:, None]) & touches & (closing > 0.0)
            soon = time < (options.time_to_collision or 0.0)
            hard = closing**2 / (2.0 * gap) > (options.needed_deceleration or np.inf)
        return (in_way & (soon | hard)).any(axis=1), in_way.any(axis=1)
