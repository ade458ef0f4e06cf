"""What controllers ask for, in highway-env's terms."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Action, Vehicles
from avrare.errors import UsageError
from avrare.protocols import Floats

ACCELERATION = 5.0
"""Of full throttle [m/s^2]."""
STEERING = np.pi / 4
"""Of full lock [rad]."""
_SLOWEST = 0.1
"""Below this speed [m/s] a yaw rate asks for no more steering."""


def native_action(action: Any, ego: Vehicles, wheelbase: float) -> Floats:
    """(N, 2) throttle and steering in [-1, 1], right is positive.

    Args:
        action: An ``Action``, or (N, 2) throttle and steering in [-1, 1], left is positive.
        ego: Its speed turns a yaw rate into a steering angle.
        wheelbase: highway-env's is the vehicle's length [m].

    Raises:
        UsageError: It is neither.
        ValueError: It is NaN: an error of the rollout.
    """
    if isinstance(action, Action):
        # heading' = v sin(slip) / (wheelbase / 2), tan(slip) = tan(steering) / 2
        slip = np.clip(0.5 * wheelbase * action.yaw_rate / np.maximum(ego.speed, _SLOWEST), -0.7, 0.7)
        steering = np.arctan(2.0 * np.tan(np.arcsin(slip)))
        action = np.stack([action.acceleration / ACCELERATION, steering / STEERING], axis=1)
    if action is None:
        raise UsageError("highway_env needs a controller", "add a `controller:` block to the scenario")
    if not isinstance(action, np.ndarray) or action.shape != (len(ego.x), 2):
        shape = getattr(action, "shape", type(action).__name__)
        raise UsageError(
            f"highway_env needs throttle and steering, ({len(ego.x)}, 2), the controller gave {shape}"
        )
    if np.isnan(action).any():
        raise ValueError("the controller's action is NaN")
    return np.asarray(np.clip(np.stack([action[:, 0], -action[:, 1]], axis=1), -1.0, 1.0))
