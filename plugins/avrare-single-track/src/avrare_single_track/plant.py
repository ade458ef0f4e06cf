"""Ego as a kinematic single-track vehicle about its centre (Rajamani, Vehicle Dynamics and Control, 2.2).

With steering angle δ, wheelbase L and the centre half-way between the axles:
β = atan(tan(δ) / 2), x' = v cos(h + β), y' = v sin(h + β), h' = v cos(β) tan(δ) / L, v' = a.
The controller commands acceleration and yaw rate; the plant converts the yaw rate to a reachable steering
angle, so it is never exactly the controller's own model.

With a friction coefficient μ the tyres hold a^2 + (v h')^2 <= (μ g)^2: what is demanded beyond is scaled back
in both directions alike, which lengthens the way to stop and widens the turn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.driving import Action, Vehicles
from avrare.protocols import Bools, Floats
from avrare_single_track.config import EgoConfig
from avrare_single_track.drive_metrics import GRAVITY, lateral_acceleration, steering_angle

_ROOT = 15.0**0.5
_NODES = (0.5 - _ROOT / 10.0, 0.5, 0.5 + _ROOT / 10.0)
_WEIGHTS = (5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0)
_INNER_WEIGHTS = (
    (5.0 / 36.0, 2.0 / 9.0 - _ROOT / 15.0, 5.0 / 36.0 - _ROOT / 30.0),
    (5.0 / 36.0 + _ROOT / 24.0, 2.0 / 9.0, 5.0 / 36.0 - _ROOT / 24.0),
    (5.0 / 36.0 + _ROOT / 30.0, 2.0 / 9.0 + _ROOT / 15.0, 5.0 / 36.0),
)
"""Integrals from 0 to each node, by the values at the nodes."""
_MIN_SPEED = 0.1
"""Lower limit of the speed in the conversion of a yaw rate to a steering angle [m/s]."""


def advance(
    config: EgoConfig,
    dt: float,
    ego: Vehicles,
    steering: Floats,
    action: Action,
    friction: Floats | None = None,
) -> tuple[Vehicles, Floats, Bools]:
    """Return ego, steering angle and slipping rows (N,) one ``dt`` later, by a sixth-order step.

    It is Gauss's collocation at three nodes (Hairer, Norsett and Wanner, Solving Ordinary Differential
    Equations I, II.7): the steering angle moves linearly from its old to its new value, the speed under
    constant acceleration, so that the turn rate is known at the nodes. A row slips whose demand is beyond
    the friction circle of ``friction`` (N,), or of the options' coefficient; without either the tyres hold
    whatever is demanded.
    """
    bound = config.acceleration_max
    demanded = np.clip(action.acceleration, -bound, bound)
    speed = np.clip(ego.speed + demanded * dt, 0.0, config.speed_max)
    acceleration = (speed - ego.speed) / dt
    target = _steer(config, dt, ego.speed, steering, action.yaw_rate)
    beyond = np.zeros(len(speed), dtype=np.bool_)
    friction_coefficient = config.friction if friction is None else friction
    if friction_coefficient is not None:
        speed, target, beyond = _grip(config, friction_coefficient, dt, ego.speed, speed, target)
        acceleration = (speed - ego.speed) / dt
    slope = (target - steering) / dt

    turns, slips, speeds = [], [], []
    for node in _NODES:
        v, tan = ego.speed + acceleration * node * dt, np.tan(steering + slope * node * dt)
        slip = np.arctan(0.5 * tan)
        turns.append(v * np.cos(slip) * tan / config.wheelbase)
        slips.append(slip)
        speeds.append(v)
    x, y = ego.x, ego.y
    for speed_at, slip, weight, inner in zip(speeds, slips, _WEIGHTS, _INNER_WEIGHTS, strict=True):
        course = ego.heading + dt * _combine(inner, turns) + slip
        x, y = x + dt * weight * speed_at * np.cos(course), y + dt * weight * speed_at * np.sin(course)
    heading = ego.heading + dt * _combine(_WEIGHTS, turns)
    return Vehicles(x, y, heading, speed, acceleration), target, beyond


def _combine(weights: Sequence[float], values: Sequence[Floats]) -> Floats:
    # A matrix product's bits depend on the number of rows; this sum's do not.
    first, second, third = (weight * value for weight, value in zip(weights, values, strict=True))
    return first + second + third


def _grip(
    config: EgoConfig, friction: Floats | float, dt: float, before: Floats, speed: Floats, steering: Floats
) -> tuple[Floats, Floats, Bools]:
    # Speed and angle at the end of the step, of which the tyres hold the share ``share``.
    along, across = (speed - before) / dt, lateral_acceleration(speed, steering, config.wheelbase)
    demanded = np.hypot(along, across)
    beyond = demanded > friction * GRAVITY
    share = np.where(beyond, friction * GRAVITY / np.where(beyond, demanded, 1.0), 1.0)
    held = np.where(beyond, before + share * along * dt, speed)
    ratio = config.wheelbase * share * across / np.maximum(held, _MIN_SPEED) ** 2
    return held, np.where(beyond, steering_angle(ratio), steering), beyond


def _steer(config: EgoConfig, dt: float, speed: Floats, steering: Floats, yaw_rate: Floats) -> Floats:
    desired_angle = steering_angle(config.wheelbase * yaw_rate / np.maximum(speed, _MIN_SPEED))
    reach = config.steering_rate_max * dt
    reachable = np.clip(desired_angle, steering - reach, steering + reach)
    return np.asarray(np.clip(reachable, -config.steering_max, config.steering_max))
