"""Conversion of controllers' actions to those of highway-env."""

from __future__ import annotations

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Action, Vehicles
from avrare.protocols import Floats

ACCELERATION = 5.0
"""Acceleration at full throttle [m/s^2]."""
STEERING = np.pi / 4
"""Steering angle at full lock [rad]."""


def native_action(action: object, ego: Vehicles, wheelbase: float) -> Floats:
    """Return throttle and steering (N, 2) in [-1, 1], right is positive.

    Args:
        action: An ``Action``, or (N, 2) throttle and steering in [-1, 1], left is positive.
        ego: Ego, whose speed converts a yaw rate into a steering angle.
        wheelbase: Wheelbase, in highway-env the vehicle's length [m].

    Raises:
        UsageError: The action is neither.
        ValueError: The action is NaN (a rollout error).
    """
    if isinstance(action, Action):
        # heading' = v sin(slip) / (wheelbase / 2), tan(slip) = tan(steering) / 2
        # least speed [m/s] at which a yaw rate gives a slip angle
        slip = np.clip(0.5 * wheelbase * action.yaw_rate / np.maximum(ego.speed, 0.1), -0.7, 0.7)
        steering = np.arctan(2.0 * np.tan(np.arcsin(slip)))
        action = np.stack([action.acceleration / ACCELERATION, steering / STEERING], axis=1)
    if action is None:
        raise UsageError("highway_env needs a controller", "add a `controller:` block to the scenario")
    if not isinstance(action, np.ndarray) or action.shape != (len(ego.x), 2):
        shape = action.shape if isinstance(action, np.ndarray | np.generic) else type(action).__name__
        raise UsageError(
            f"highway_env needs throttle and steering ({len(ego.x)}, 2), the controller returned {shape}"
        )
    if np.isnan(action).any():
        raise ValueError("the controller's action is NaN")
    return np.asarray(np.clip(np.stack([action[:, 0], -action[:, 1]], axis=1), -1.0, 1.0))
