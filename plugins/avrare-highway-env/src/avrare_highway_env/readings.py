"""Reading the vehicles themselves: highway-env's own observations cost more than its physics.

highway-env's y points to the right and its headings turn to the right; here both are mirrored.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats

ABSENT = 1e6
"""x and y of a vehicle that is not there [m]."""
EGO = ("x", "y", "heading", "speed", "acceleration", "steering", "crashed", "arrived", "on_road", "over")
"""First numbers of a reading; after them come five for every other vehicle."""
_NOBODY = (ABSENT, ABSENT, 0.0, 0.0, 0.0)


def read(environment: Any, capacity: int, goal: float | None, dt: float) -> list[float]:
    """One world as numbers: ``EGO``, then x, y, heading, speed, acceleration of ``capacity`` others."""
    road, ego = environment.road, environment.vehicle
    others = [thing for thing in (*road.vehicles, *road.objects) if thing is not ego][:capacity]
    on_road, crashed = bool(ego.on_road), bool(ego.crashed)
    there = ego.position[0] > goal if goal is not None else _arrived(environment, ego)
    found = [*_kinematics(ego, dt, crashed), 0.0 - float(ego.action["steering"])]
    found += [crashed, there and on_road, on_road, crashed or there]
    for other in others:
        found += _kinematics(other, dt, crashed)
    return found + list(_NOBODY) * (capacity - len(others))


def _kinematics(thing: Any, dt: float, crashed: bool) -> tuple[float, ...]:
    """In a crash of the ego without the push by which highway-env takes colliding bodies apart again."""
    pushed = getattr(thing, "pushed", None)
    x, y = (thing.position if pushed is None or not crashed else thing.position - pushed).tolist()
    speed = float(thing.speed)
    return x, 0.0 - y, 0.0 - float(thing.heading), speed, (speed - getattr(thing, "speed_before", speed)) / dt


def _arrived(environment: Any, ego: Any) -> bool:
    arrived = getattr(environment, "has_arrived", None)
    return bool(arrived(ego)) if arrived is not None else False


def others_of(readings: Floats) -> Vehicles:
    """The others (N, V) of readings (N, ...)."""
    table = readings[:, len(EGO) :].reshape(len(readings), -1, 5)
    return Vehicles(*(np.ascontiguousarray(table[:, :, k]) for k in range(5)))


def gap_ahead(ego: Vehicles, ego_size: tuple[float, float], others: Vehicles, lengths: Floats,
              widths: Floats) -> Floats:  # fmt: skip
    """(N,) bumper to bumper to the nearest vehicle in the ego's corridor ahead [m]; inf where it is free."""
    dx, dy = others.x - ego.x[:, None], others.y - ego.y[:, None]
    cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    ahead = (along > 0.0) & (np.abs(across) < 0.5 * (widths + ego_size[1]))
    gap = np.where(ahead, along - 0.5 * (lengths + ego_size[0]), np.inf)
    return np.asarray(gap.min(axis=1, initial=np.inf))
