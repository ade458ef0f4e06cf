"""Snapshots of highway-env worlds as copies of the vehicles' attributes, and readings of them as numbers.

A deep copy takes 20 times as long and also copies the road, which never changes. A restored world continues
bit-identically. highway-env's y axis and headings point to the right; those of readings to the left. Its own
observations take longer than its physics.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats

if TYPE_CHECKING:
    from highway_env.envs.common.abstract import AbstractEnv
    from highway_env.road.road import Road
    from highway_env.vehicle.kinematics import Vehicle
    from highway_env.vehicle.objects import RoadObject


@dataclass(frozen=True)
class Snapshot:
    """Immutable state of one world.

    Attributes:
        objects: Class and attributes of the vehicles, then of the obstacles.
        vehicles: Number of vehicles.
        ego: Index of the ego.
        clock: Step counter of a regulated road, else 0.
    """

    objects: tuple[tuple[type[RoadObject], dict[str, object]], ...]
    vehicles: int
    ego: int
    clock: int


def capture(environment: AbstractEnv) -> Snapshot:
    """Return a snapshot of the environment."""
    road = environment.road
    objects = [*road.vehicles, *road.objects]
    ego = next(k for k, vehicle in enumerate(road.vehicles) if vehicle is environment.vehicle)
    copies = tuple((type(body), _copy(vars(body))) for body in objects)
    return Snapshot(copies, len(road.vehicles), ego, road.steps if hasattr(road, "steps") else 0)


def restore(environment: AbstractEnv, snapshot: Snapshot) -> None:
    """Restore a snapshot of the same road."""
    road = environment.road
    objects = [_make(kind, attributes, road) for kind, attributes in snapshot.objects]
    road.vehicles, road.objects = objects[: snapshot.vehicles], objects[snapshot.vehicles :]
    environment.controlled_vehicles = [road.vehicles[snapshot.ego]]
    if hasattr(road, "steps"):
        road.steps = snapshot.clock


def _copy(attributes: dict[str, object]) -> dict[str, object]:
    # attributes that refer to the road, or serve only rendering
    shared = frozenset({"road", "lane", "history", "log"})
    return {
        name: value.copy() if isinstance(value, (np.ndarray, dict, list)) else value
        for name, value in attributes.items()
        if name not in shared
    }


def _make(kind: type[RoadObject], attributes: dict[str, object], road: Road) -> RoadObject:
    body: RoadObject = object.__new__(kind)
    vars(body).update(_copy(attributes))
    body.road = road
    body.lane = road.network.get_lane(body.lane_index)
    body.log, body.history = [], deque(maxlen=1)
    return body


ABSENT = 1e6
"""x and y of an absent vehicle [m]."""
EGO = ("x", "y", "heading", "speed", "acceleration", "steering", "crashed", "arrived", "on_road", "over")
"""First numbers of a reading; five numbers per other vehicle follow."""


def read(environment: AbstractEnv, capacity: int, goal: float | None, dt: float) -> list[float]:
    """Return a world as numbers: ``EGO``, then x, y, heading, speed, acceleration of the others."""
    road, ego = environment.road, environment.vehicle
    others = [body for body in (*road.vehicles, *road.objects) if body is not ego]
    on_road, crashed = bool(ego.on_road), bool(ego.crashed)
    arrived = ego.position[0] > goal if goal is not None else _has_arrived(environment, ego)
    numbers = [*_kinematics(ego, dt, crashed), 0.0 - float(ego.action["steering"])]
    numbers += [crashed, arrived and on_road, on_road, crashed or arrived]
    states: list[tuple[float, ...]] = [(ABSENT, ABSENT, 0.0, 0.0, 0.0)] * capacity
    for k, other in enumerate(others):
        if (slot := getattr(other, "slot", k)) < capacity:
            states[slot] = _kinematics(other, dt, crashed)
    return numbers + [number for state in states for number in state]


def _kinematics(body: RoadObject, dt: float, crashed: bool) -> tuple[float, ...]:
    """Return x, y, heading, speed, acceleration; in a crash without the push that separates the bodies."""
    pushed = getattr(body, "pushed", None)
    x, y = (body.position if pushed is None or not crashed else body.position - pushed).tolist()
    speed = float(body.speed)
    return x, 0.0 - y, 0.0 - float(body.heading), speed, (speed - getattr(body, "speed_before", speed)) / dt


def _has_arrived(environment: AbstractEnv, ego: Vehicle) -> bool:
    arrived = getattr(environment, "has_arrived", None)
    return bool(arrived(ego)) if arrived is not None else False


def others_of(readings: Floats) -> Vehicles:
    """Return the other vehicles (N, V) of readings (N, ...)."""
    table = readings[:, len(EGO) :].reshape(len(readings), -1, 5)
    return Vehicles(*(np.ascontiguousarray(table[:, :, k]) for k in range(5)))


def gap_ahead(
    ego: Vehicles, ego_size: tuple[float, float], others: Vehicles, lengths: Floats, widths: Floats
) -> Floats:
    """Return the gap (N,) to the nearest vehicle in the ego's corridor ahead [m]; inf if it is free."""
    dx, dy = others.x - ego.x[:, None], others.y - ego.y[:, None]
    cos, sin = np.cos(ego.heading)[:, None], np.sin(ego.heading)[:, None]
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    ahead = (along > 0.0) & (np.abs(across) < 0.5 * (widths + ego_size[1]))
    gap = np.where(ahead, along - 0.5 * (lengths + ego_size[0]), np.inf)
    return np.asarray(gap.min(axis=1, initial=np.inf))
