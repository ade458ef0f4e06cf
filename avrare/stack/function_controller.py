"""Controller ``function``: a plain function ``act(observation)`` in a Python file, for a first try.

A plugin is the lasting form: it has a version, options, tests, and a memory from step to step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.driving import Action, ObservingEgo, Prediction, Scene, Vehicles
from avrare.protocols import Controller
from avrare.stack.python_file import FileOptions, find_member

EXAMPLE = Path(__file__).with_name("templates") / "act.py.txt"
"""Function for simulators without vehicles, as `avrare new scenario --act` writes it."""


class FunctionConfig(FileOptions):
    """File and name of the function, and the form of its call."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"file": str(EXAMPLE)}]})

    function: str = Field("act", pattern=r"[A-Za-z_]\w*", description="name of the function in the file")
    batched: bool = Field(
        False, description="call it once for all rollouts, with arrays (N, ...), instead of once for each"
    )


class Neighbour(NamedTuple):
    """Other vehicle as the tracker knows it: floats, or arrays (N,) with x and y infinite where unknown.

    Attributes:
        x: Position along the road [m].
        y: Position across the road, left is positive [m].
        speed_x: Predicted speed along it [m/s].
        speed_y: Predicted speed across it [m/s].
    """

    x: Any
    y: Any
    speed_x: Any
    speed_y: Any


@dataclass(frozen=True)
class DrivingObservation:
    """Knowledge of a driving controller.

    Attributes:
        ego: x, y, heading, speed and acceleration of the ego: floats, or arrays (N,).
        others: Vehicles that the tracker knows of, by name; empty without a tracker. In a batch all of them.
        scene: Road, sizes and the step ``dt`` [s].
    """

    ego: Vehicles
    others: dict[str, Neighbour]
    scene: Scene


class FunctionController(Controller):
    """Controller that calls a function of its own file, without memory.

    Attributes:
        horizon: 1: the speeds of the others are those of the tracker's next prediction.
    """

    horizon = 1

    def __init__(self, function: Callable[..., object], batched: bool, scene: Scene | None) -> None:
        self.function, self.batched, self.scene = function, batched, scene

    def start(self, n: int) -> None:
        """Return None: it has no memory."""

    def act(self, memory: None, ego: Any, prediction: Prediction | None) -> tuple[Any, None]:
        """Return the actions of N rollouts.

        Raises:
            UsageError: The function returns a value of another shape.
        """
        if isinstance(ego, np.ndarray) or self.scene is None:
            seen = ego.observation if isinstance(ego, ObservingEgo) else ego
            return (self._answer(seen) if self.batched else self._rows(seen, len(seen))), None
        observation = DrivingObservation(ego, _neighbours(prediction, self.scene), self.scene)
        n = len(ego.x)
        answer = self._answer(observation) if self.batched else self._rows(observation, n)
        return _action(answer, n, self.batched), None

    def _rows(self, observation: object, n: int) -> Any:
        answers = [self._answer(_row(observation, row)) for row in range(n)]
        try:
            return np.array([np.atleast_1d(answer) for answer in answers], dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise UsageError(f"{self.function.__name__} must return numbers: {error}") from None

    def _answer(self, observation: object) -> Any:
        answer = self.function(observation)
        if answer is None:
            raise UsageError(f"{self.function.__name__} returned None", "return the action")
        if isinstance(answer, Action):
            return answer.acceleration, answer.yaw_rate
        return answer


def _neighbours(prediction: Prediction | None, scene: Scene) -> dict[str, Neighbour]:
    if prediction is None:
        return {}
    x, y = prediction.x, prediction.y
    tracked = np.isfinite(x[..., 0]) & np.isfinite(y[..., 0])
    with np.errstate(invalid="ignore"):  # of vehicles that are infinitely far away
        speed_x, speed_y = (np.where(tracked, p[..., 1] - p[..., 0], 0.0) / scene.dt for p in (x, y))
    return {
        name: Neighbour(x[:, v, 0], y[:, v, 0], speed_x[:, v], speed_y[:, v])
        for v, name in enumerate(scene.names)
    }


def _row(observation: Any, row: int) -> Any:
    if not isinstance(observation, DrivingObservation):
        return observation[row]
    ego = batch.map_leaves(lambda leaf: float(leaf[row]) if leaf.ndim == 1 else leaf[row], observation.ego)
    others = {
        name: Neighbour(*(float(values[row]) for values in other))
        for name, other in observation.others.items()
        if np.isfinite(other.x[row]) and np.isfinite(other.y[row])
    }
    return DrivingObservation(ego, others, observation.scene)


def _action(answer: Any, n: int, batched: bool) -> Action:
    try:
        pair = answer if batched else np.reshape(answer, (n, 2)).T
        acceleration, yaw_rate = (
            np.broadcast_to(np.asarray(values, dtype=np.float64), (n,)) for values in pair
        )
    except (TypeError, ValueError, OverflowError) as error:
        wanted = "a pair (acceleration [m/s^2], yaw rate [rad/s])"
        raise UsageError(f"a driving controller's act must return {wanted}: {error}") from None
    return Action(acceleration.copy(), yaw_rate.copy())


def build(config: FunctionConfig, scene: Scene | None) -> FunctionController:
    """Run the file and build the controller of a scenario.

    Raises:
        UsageError: The file cannot be run, or has no such function.
    """
    function = find_member(config.file, config.function, "def {}(observation): ...")
    return FunctionController(function, config.batched, scene)
