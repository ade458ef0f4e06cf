"""Controller that plans at its own rate and whose commands arrive late, and its actuators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.driving import Action, Prediction, Road, Scene, Vehicles
from avrare.driving.values import to_plane, to_road
from avrare.protocols import Controller, Floats
from avrare.scenario.timing import Actuators, Timing
from avrare.stack.clock import Clock, move_samples, round_up


@dataclass(frozen=True)
class CommandQueue:
    """Memory of a timed controller.

    Attributes:
        step: (N,) steps since the start.
        planner: Memory of the controller itself.
        command: Newest command, or None before the first one.
        queue: Commands on their way, the oldest first.
        level: Action that the actuators have reached, or None before the first command.
        missed: (N,) planning cycles that gave no command.
    """

    step: NDArray[np.int64]
    planner: Any
    command: Any
    queue: tuple[Any, ...]
    level: Any
    missed: NDArray[np.int64]


class TimedController(Controller):
    """Controller with a planning period, missed cycles, delays and actuators.

    The first commands arrive late, too: until then the ego holds speed and course.

    Attributes:
        controller: The controller itself.
        noise_names: Name of each number that it takes from the tape.
    """

    def __init__(
        self, controller: Controller, timing: Timing, clock: Clock, actuators: Actuators, scene: Scene | None
    ) -> None:
        self.controller, self._timing, self._clock = controller, timing, clock
        self._actuators, self._scene, self.sees_truth = actuators, scene, controller.sees_truth
        self._response = Response(actuators, clock.dt) if actuators != Actuators() else None
        self._road = scene.road if scene is not None else None
        if timing.compensated and self._road is None:
            raise UsageError("timing.compensated: needs a simulator with a road", "remove the option")
        self._ahead = (clock.age + clock.delay) / clock.planner if timing.compensated else 0.0
        self.horizon = controller.horizon + round_up(self._ahead)
        self.noise_names = ("loss of planning cycles",) if timing.missed_cycles else ()

    def around(self, controller: Controller) -> TimedController:
        """Return this clocked controller around another controller."""
        return TimedController(controller, self._timing, self._clock, self._actuators, self._scene)

    def compensating(self) -> TimedController | None:
        """Return a controller that knows its delays; None if this one knows them or has none."""
        if self._timing.compensated or not self._clock.age + self._clock.delay or self._road is None:
            return None
        timing = self._timing.model_copy(update={"compensated": True})
        return TimedController(self.controller, timing, self._clock, self._actuators, self._scene)

    def pace(self, scene: Scene | None) -> Scene | None:
        """Return a scene at the planner's period."""
        return self._clock.pace_scene(scene, self._clock.planner)

    def start(self, n: int) -> CommandQueue:
        """Return the memory of ``n`` particles before the first step."""
        zeros = np.zeros(n, dtype=np.int64)
        return CommandQueue(zeros, self.controller.start(n), None, (), None, zeros)

    def act(
        self, memory: CommandQueue, ego: Any, prediction: Prediction | None, noise: Floats | None = None
    ) -> tuple[Any, CommandQueue]:
        """Return the response of the actuators in the next step, and the memory after it.

        Without ``noise`` (N, len(noise_names)) no cycle is missed.
        """
        if memory.step[0] % self._clock.planner == 0:  # it is that of all rows
            memory = self._plan(memory, ego, prediction, noise)
        queue = (*memory.queue, memory.command)
        action, level = queue[0], None
        if self._response is not None:
            action, level = self._response.follow(memory.level, queue[0], ego.speed)
        return action, replace(memory, step=memory.step + 1, queue=queue[1:], level=level)

    def counts(self, memory: CommandQueue) -> Mapping[str, NDArray[np.int64]]:
        """Return the counters of the controller itself, and ``missed_cycles``."""
        return {**self.controller.counts(memory.planner)} | (
            {"missed_cycles": memory.missed} if self.noise_names else {}
        )

    def plan(self, memory: CommandQueue) -> Floats | None:
        """Return the plan of the controller itself."""
        return self.controller.plan(memory.planner)

    def features(self, memory: CommandQueue) -> Floats | None:
        """Return the features (N, F) of the controller itself."""
        return self.controller.features(memory.planner)

    def _plan(
        self, memory: CommandQueue, ego: Any, prediction: Prediction | None, noise: Floats | None
    ) -> CommandQueue:
        if self._ahead:
            ego = self._look_ahead(memory, ego)
        if self._ahead and prediction is not None:
            prediction = move_samples(prediction, self._ahead, 1.0, self.controller.horizon)
        command, planner = self.controller.act(memory.planner, ego, prediction)
        if memory.command is None:
            idle = batch.map_leaves(np.zeros_like, command)
            level = idle if self._response is not None else None
            memory = replace(memory, command=idle, queue=(idle,) * self._clock.delay, level=level)
        if noise is None or not self.noise_names:
            return replace(memory, command=command, planner=planner)
        missed = noise[:, 0] < NormalDist().inv_cdf(self._timing.missed_cycles)
        return replace(
            memory,
            command=batch.choose(missed, memory.command, command),
            planner=batch.choose(missed, memory.planner, planner),
            missed=memory.missed + missed,
        )

    def _look_ahead(self, memory: CommandQueue, ego: Vehicles) -> Vehicles:
        """Return the ego where the first command of a new plan will reach it."""
        level = memory.level
        for command in memory.queue:
            action = command
            if self._response is not None:
                action, level = self._response.follow(level, command, ego.speed)
            ego = _move(self._road, self._clock.dt, ego, action)
        return ego


def _move(road: Road | None, dt: float, ego: Vehicles, action: Action) -> Vehicles:
    if road is not None:
        ego = to_plane(road, ego)
    speed = np.maximum(ego.speed + action.acceleration * dt, 0.0)
    course, way = ego.heading + 0.5 * dt * action.yaw_rate, 0.5 * dt * (ego.speed + speed)
    moved = Vehicles(
        ego.x + way * np.cos(course),
        ego.y + way * np.sin(course),
        ego.heading + dt * action.yaw_rate,
        speed,
        action.acceleration,
    )
    return moved if road is None or road.line is None else to_road(road.line, moved)


class Response:
    """Response of actuators to commands: first-order lags, and bounds of jerk and power.

    The action of a step is the mean of the response over the step, so that speeds and courses at its end are
    those of the response in continuous time.
    """

    def __init__(self, actuators: Actuators, dt: float) -> None:
        self._dt, self._jerk, self._power = dt, actuators.jerk_max, actuators.power_max
        self._acceleration = _lag_gains(actuators.acceleration_lag, dt)
        self._turn = _lag_gains(actuators.turn_lag, dt)

    def follow(self, level: Action, command: Action, speed: Floats) -> tuple[Action, Action]:
        """Return the mean action of a step and that at its end."""
        acceleration = command.acceleration
        if self._power is not None:
            # the power bounds the acceleration from here on [m/s]
            acceleration = np.minimum(acceleration, self._power / np.maximum(speed, 0.1))
        change = self._acceleration[0] * (acceleration - level.acceleration)
        if self._jerk is not None:
            change = np.clip(change, -self._jerk * self._dt, self._jerk * self._dt)
        turn = self._turn[0] * (command.yaw_rate - level.yaw_rate)
        mean = Action(
            level.acceleration + self._acceleration[1] * change, level.yaw_rate + self._turn[1] * turn
        )
        return mean, Action(level.acceleration + change, level.yaw_rate + turn)


def _lag_gains(time_constant: float, dt: float) -> tuple[float, float]:
    """Return the share of a change that is reached after a step, and the mean share of that over the step."""
    if time_constant == 0.0:
        return 1.0, 1.0
    reached = -math.expm1(-dt / time_constant)
    return reached, (1.0 - time_constant / dt * reached) / reached
