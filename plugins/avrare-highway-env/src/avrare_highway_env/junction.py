"""Crossing as rules see it: ways through it, and conflict areas where others have priority over the ego."""

from __future__ import annotations

import dataclasses
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import PolygonalLine
from avrare.protocols import Floats
from avrare_recordings.roads.ways import Way, find_crossing

if TYPE_CHECKING:
    from highway_env.envs.common.abstract import AbstractEnv
    from highway_env.road.lane import AbstractLane
    from highway_env.road.road import RoadNetwork
    from highway_env.vehicle.kinematics import Vehicle

TURNS = {"right": 3, "straight": 2, "left": 1}
"""Quarters from the corner where a way comes in to that where it leaves."""
_UNKNOWN = -1


def crossing_road(network: RoadNetwork, turn: str) -> Road:
    """Return a road without lanes, in the plane, with the conflict areas on the ego's way from the south.

    The road from west to east has priority, as for highway-env's own drivers.
    """
    ways = {(corner, name): _find_way(network, corner, name) for corner in range(4) for name in TURNS}
    ego_way, leaving = ways[0, turn], f"o{TURNS[turn]}"
    parts = [
        _middle(network, "o0", "ir0"),
        ego_way.line.points,
        _middle(network, f"il{TURNS[turn]}", leaving),
    ]
    line = PolygonalLine(np.concatenate(parts))
    areas = [find_crossing(line, ego_way, other) for (corner, _), other in ways.items() if corner]
    names = [other.name for (corner, _), other in ways.items() if corner]
    crossings = tuple(
        dataclasses.replace(area, way=name, ego_line=line)
        for area, name in zip(areas, names, strict=True)
        if area is not None
    )
    width = float(network.get_lane(("o0", "ir0", 0)).width)
    return Road((), width, crossings=crossings)


def list_paths(network: RoadNetwork) -> tuple[Floats, ...]:
    """Return the centre lines (K, 2) of all lanes in the plane [m]."""
    return tuple(_border(lane, 0.0) for lane in network.lanes_list())


def label_vehicles(environment: AbstractEnv) -> None:
    """Give each new vehicle the least free slot, which it keeps, and the number of its way."""
    others = [vehicle for vehicle in environment.road.vehicles if vehicle is not environment.vehicle]
    taken = {vehicle.slot for vehicle in others if hasattr(vehicle, "slot")}
    free = (slot for slot in count() if slot not in taken)
    for vehicle in others:
        if not hasattr(vehicle, "slot"):
            vehicle.slot, vehicle.way = next(free), _find_planned_way(vehicle)


def read_ways(environment: AbstractEnv, capacity: int) -> list[float]:
    """Return the number of the way of the vehicle in each slot, -1 where there is none."""
    ways = [float(_UNKNOWN)] * capacity
    for vehicle in environment.road.vehicles:
        if vehicle is not environment.vehicle and vehicle.slot < capacity:
            ways[vehicle.slot] = float(vehicle.way)
    return ways


def _find_planned_way(vehicle: Vehicle) -> int:
    route = [vehicle.lane_index, *(vehicle.route or ())]
    for begin, end, _ in route:
        if begin.startswith("ir"):
            return _number(int(begin[2:]), (int(end[2:]) - int(begin[2:])) % 4)
    return _UNKNOWN


def _number(corner: int, quarters: int) -> int:
    return 4 * corner + quarters


def _find_way(network: RoadNetwork, corner: int, turn: str) -> Way:
    lane = network.get_lane((f"ir{corner}", f"il{(corner + TURNS[turn]) % 4}", 0))
    incoming = network.get_lane((f"o{corner}", f"ir{corner}", 0))
    half = 0.5 * float(lane.width)
    heading = -float(incoming.heading_at(incoming.length))
    rank = 2 if corner % 2 else 0
    name = _number(corner, TURNS[turn])
    return Way(name, _border(lane, -half), _border(lane, half), rank, heading, turn)


def _middle(network: RoadNetwork, begin: str, end: str) -> Floats:
    return _border(network.get_lane((begin, end, 0)), 0.0)[[0, -1]]


def _border(lane: AbstractLane, right: float) -> Floats:
    # highway-env's y points to the right
    places = [lane.position(s, right) for s in np.linspace(0.0, float(lane.length), 33)]
    return np.array(places, dtype=np.float64) * (1.0, -1.0)
