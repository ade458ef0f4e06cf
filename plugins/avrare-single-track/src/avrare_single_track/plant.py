"""Ego as a kinematic single-track vehicle about its centre (Rajamani, Vehicle Dynamics and Control, 2.2).

With steering angle δ, wheelbase L and the centre half-way between the axles:
β = atan(tan(δ) / 2), x' = v cos(h + β), y' = v sin(h + β), h' = v cos(β) tan(δ) / L, v' = a.
The controller commands acceleration and yaw rate; the plant converts the yaw rate to a reachable steering
angle, so it is never exactly the controller's own model.
"""

from __future__ import annotations

import numpy as np

from avrare.driving import Action, Vehicles
from avrare.protocols import Floats
from avrare_single_track.config import EgoConfig

_MIN_SPEED = 0.1
"""Lower limit of the speed in the conversion of a yaw rate to a steering angle [m/s]."""


def advance(
    config: EgoConfig, dt: float, ego: Vehicles, steering: Floats, action: Action
) -> tuple[Vehicles, Floats]:
    """Return ego and steering angle one ``dt`` later, by one Runge-Kutta step of fourth order.

    The steering angle moves linearly from its old to its new value, the speed under constant acceleration.
    """
    bound = config.acceleration_max
    wanted = np.clip(action.acceleration, -bound, bound)
    speed = np.clip(ego.speed + wanted * dt, 0.0, config.speed_max)
    acceleration = (speed - ego.speed) / dt
    target = _steer(config, dt, ego.speed, steering, action.yaw_rate)
    slope = (target - steering) / dt

    def rates(time: float, heading: Floats) -> tuple[Floats, Floats, Floats]:
        v, tan = ego.speed + acceleration * time, np.tan(steering + slope * time)
        slip = np.arctan(0.5 * tan)
        course = heading + slip
        return v * np.cos(course), v * np.sin(course), v * np.cos(slip) * tan / config.wheelbase

    k1 = rates(0.0, ego.heading)
    k2 = rates(0.5 * dt, ego.heading + 0.5 * dt * k1[2])
    k3 = rates(0.5 * dt, ego.heading + 0.5 * dt * k2[2])
    k4 = rates(dt, ego.heading + dt * k3[2])
    dx, dy, dh = (dt / 6.0 * (a + 2.0 * b + 2.0 * c + d) for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return Vehicles(ego.x + dx, ego.y + dy, ego.heading + dh, speed, acceleration), target


def _steer(config: EgoConfig, dt: float, speed: Floats, steering: Floats, yaw_rate: Floats) -> Floats:
    ratio = config.wheelbase * yaw_rate / np.maximum(speed, _MIN_SPEED)
    # h' L / v = tan(δ) cos(atan(tan(δ) / 2)) = u  =>  tan(δ)^2 = u^2 / (1 - u^2 / 4)
    ratio = np.clip(ratio, -1.9, 1.9)
    wanted = np.arctan(ratio / np.sqrt(1.0 - 0.25 * ratio**2))
    reach = config.steering_rate_max * dt
    reachable = np.clip(wanted, steering - reach, steering + reach)
    return np.asarray(np.clip(reachable, -config.steering_max, config.steering_max))
