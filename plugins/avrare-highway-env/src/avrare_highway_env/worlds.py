"""Snapshots of a highway-env world: its vehicles' attributes, copied by hand.

A deep copy takes 20 times as long, and copies the road, which never changes. A restored world runs on bit for
bit as the one it was taken from would have.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

_SHARED = frozenset({"road", "lane", "history", "log"})
"""Attributes that are references into the road, or are for pictures alone."""


@dataclass(frozen=True)
class Snapshot:
    """One world at one time; nothing in it may be changed.

    Attributes:
        objects: Class and attributes of the vehicles, then of the obstacles.
        vehicles: How many of them are vehicles.
        ego: Index of the ego.
        clock: Steps of a regulated road, else 0.
    """

    objects: tuple[tuple[type[Any], dict[str, Any]], ...]
    vehicles: int
    ego: int
    clock: int


def capture(environment: Any) -> Snapshot:
    """The world as it stands."""
    road = environment.road
    objects = [*road.vehicles, *road.objects]
    ego = next(k for k, vehicle in enumerate(road.vehicles) if vehicle is environment.vehicle)
    copies = tuple((type(thing), _copied(vars(thing))) for thing in objects)
    return Snapshot(copies, len(road.vehicles), ego, getattr(road, "steps", 0))


def restore(environment: Any, snapshot: Snapshot) -> None:
    """Put the environment, which has the same road, into the snapshot's world."""
    road = environment.road
    objects = [_made(kind, attributes, road) for kind, attributes in snapshot.objects]
    road.vehicles, road.objects = objects[: snapshot.vehicles], objects[snapshot.vehicles :]
    environment.controlled_vehicles = [road.vehicles[snapshot.ego]]
    if hasattr(road, "steps"):
        road.steps = snapshot.clock


def _copied(attributes: dict[str, Any]) -> dict[str, Any]:
    """Vehicles change these in place: positions, impacts, actions, routes."""
    return {
        name: value.copy() if isinstance(value, (np.ndarray, dict, list)) else value
        for name, value in attributes.items()
        if name not in _SHARED
    }


def _made(kind: type[Any], attributes: dict[str, Any], road: Any) -> Any:
    thing: Any = object.__new__(kind)
    vars(thing).update(_copied(attributes))
    thing.road = road
    thing.lane = road.network.get_lane(thing.lane_index)
    thing.log, thing.history = [], deque(maxlen=1)
    return thing
