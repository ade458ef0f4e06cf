"""Clock of a stack: periods and delays of its parts in steps of the simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Prediction, Scene
from avrare.protocols import Floats
from avrare.scenario.timing import Timing

_SAME = 1e-6
"""Shares of a step that are taken for rounding."""


@dataclass(frozen=True)
class Clock:
    """Periods and delays in steps of the simulator.

    Attributes:
        dt: Step of the simulator [s].
        sensor: Steps between frames.
        tracker: Steps between updates of the tracker.
        planner: Steps between plans.
        latency: Steps until a frame can be read, if it has no jitter.
        delay: Steps from the start of a plan to the actuators' answer.
    """

    dt: float
    sensor: int = 1
    tracker: int = 1
    planner: int = 1
    latency: int = 0
    delay: int = 0

    @property
    def age(self) -> int:
        """Steps from a frame without jitter to the update of the tracker that reads it."""
        return self.sensor * round_up(self.latency / self.sensor)

    @classmethod
    def of(cls, timing: Timing, dt: float) -> Clock:
        """Return the clock of ``timing``.

        Raises:
            UsageError: A period is not a multiple of the step, or the tracker's not of the sensor's.
        """
        for name, error in timing.find_faults(dt).items():
            raise UsageError(f"{name}: {error.message}", error.hint)
        sensor = timing.sensor_period or dt
        delay = round(timing.planning_latency / dt) + round(timing.actuation_delay / dt)
        return cls(
            dt,
            round(sensor / dt),
            round((timing.tracker_period or sensor) / dt),
            round((timing.planner_period or dt) / dt),
            round_up(timing.perception_latency / dt),
            delay,
        )

    def pace_scene(self, scene: Scene | None, steps: int) -> Scene | None:
        """Return the scene for a part that works every ``steps`` steps."""
        return None if scene is None else replace(scene, dt=steps * self.dt)


def round_up(steps: float) -> int:
    """Return the least number of whole steps that is not less, except for rounding."""
    return math.ceil(steps - _SAME)


def round_up_each(steps: Floats) -> NDArray[np.int64]:
    """Round each of (N,) up, as ``round_up`` does."""
    return np.ceil(steps - _SAME).astype(np.int64)


def move_samples(prediction: Prediction, first: float, stride: float, steps: int) -> Prediction:
    """Return a prediction at other times, linear between its samples.

    Args:
        prediction: With at least ``round_up(first + stride * steps)`` steps.
        first: Time of the new sample 0, in steps of ``prediction``.
        stride: Length of the new steps, likewise.
        steps: Number of new steps.
    """
    if (first, stride) == (0.0, 1.0):
        return Prediction(prediction.x[..., : steps + 1], prediction.y[..., : steps + 1])
    times = [first + stride * sample for sample in range(steps + 1)]
    return Prediction(
        *(np.stack([_at(values, t) for t in times], -1) for values in vars(prediction).values())
    )


def _at(values: Floats, time: float) -> Floats:
    before = math.floor(time + _SAME)
    share = time - before
    if share < _SAME:
        return values[..., before]
    return np.asarray((1.0 - share) * values[..., before] + share * values[..., before + 1])
