"""Quantities of a drive: lateral acceleration, steering angle, time to collision."""

from __future__ import annotations

import numpy as np

from avrare.driving import Scene, Vehicles
from avrare.protocols import Floats

GRAVITY = 9.81
"""Standard gravity [m/s^2]."""


def lateral_acceleration(speed: Floats, steering: Floats, wheelbase: float) -> Floats:
    """Return v h' = v^2 cos(β) tan(δ) / L [m/s^2], positive to the left, with β = atan(tan(δ) / 2).

    It is the lateral acceleration of a turn at this angle; what the centre gains while the angle changes,
    v β', is left out, as in the friction circle of the kinematic models of CommonRoad (Althoff and Würsching,
    CommonRoad: Vehicle Models).
    """
    tan = np.tan(steering)
    return np.asarray(speed**2 * np.cos(np.arctan(0.5 * tan)) * tan / wheelbase)


def steering_angle(ratio: Floats) -> Floats:
    """Return δ [rad] for ``ratio`` u = L h' / v = tan(δ) cos(β), so tan(δ)^2 = u^2 / (1 - u^2 / 4)."""
    ratio = np.clip(ratio, -1.9, 1.9)
    return np.asarray(np.arctan(ratio / np.sqrt(1.0 - 0.25 * ratio**2)))


def time_to_collision(ego: Vehicles, others: Vehicles, scene: Scene) -> Floats:
    """Return (N,) the least time until the boxes of the ego and of a vehicle ahead touch [s].

    Boxes are parallel to the road and velocities are constant. Ahead is a vehicle whose centre is; inf
    where none is ahead, or none would be touched.
    """
    boxes = [
        _box(ego, np.asarray(scene.ego_length), np.asarray(scene.ego_width)),
        _box(others, scene.lengths, scene.widths),
    ]
    enter, leave = np.zeros(others.x.shape), np.full(others.x.shape, np.inf)
    for (at, reach, speed), (their_at, their_reach, their_speed) in zip(*boxes, strict=True):
        apart, closing = their_at - at[:, None], speed[:, None] - their_speed
        near, far = (apart - side * (reach[:, None] + their_reach) for side in (1.0, -1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            first, last = (np.where(closing > 0.0, *pair) / closing for pair in ((near, far), (far, near)))
        still = closing == 0.0
        touching = (near <= 0.0) & (far >= 0.0)
        enter = np.maximum(enter, np.where(still, np.where(touching, 0.0, np.inf), first))
        leave = np.minimum(leave, np.where(still, np.inf, last))
    ahead = others.x > ego.x[:, None]
    times = np.where(ahead & (enter <= leave), enter, np.inf)
    return np.asarray(times.min(axis=1, initial=np.inf))


def _box(vehicles: Vehicles, length: Floats, width: Floats) -> tuple[tuple[Floats, Floats, Floats], ...]:
    # Centre, half the extent and speed, along and across the road.
    cos, sin = np.cos(vehicles.heading), np.sin(vehicles.heading)
    along, across = np.abs(cos), np.abs(sin)
    return (
        (vehicles.x, 0.5 * (length * along + width * across), vehicles.speed * cos),
        (vehicles.y, 0.5 * (length * across + width * along), vehicles.speed * sin),
    )
