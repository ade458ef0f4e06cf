"""Junctions on the way of the ego: where it meets ways whose traffic has priority."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from avrare_openscenario.network import Connection, Network, RoadMap
from avrare_recordings.roads.ways import Way, find_crossing

_STEP = 0.5
"""Distance of the points of a border [m]."""
_TURN = 0.25 * np.pi
"""Least turn of a way that is not straight on [rad]."""


def add_crossings(network: Network, roads: RoadMap) -> RoadMap:
    """Return a way through junctions with its stop signs, and the areas in which others have priority."""
    areas, stops = [], []
    for before, after in pairwise(roads.legs):
        incoming = id(before.roads), before.direction
        for way in network.find_ways(before.roads, before.direction):
            if way.junction and way.roads is after.roads and way.lanes.get(before.lane) == after.lane:
                mine = _build(way, after.lane)
                stops += [after.begin] if way.rank < 0 else []
                others = _list_others(network, way.junction, incoming)
                areas += [find_crossing(roads.line, mine, other) for other in others]
    found = tuple(area for area in areas if area is not None)
    return replace(roads, road=replace(roads.road, crossings=found, stop_signs=tuple(stops)))


def _list_others(network: Network, junction: str, incoming: tuple[int, int]) -> Iterator[Way]:
    for key, ways in network.connections.items():
        for way in ways:
            if way.junction == junction and key != incoming:
                yield from (_build(way, lane) for lane in set(way.lanes.values()) if _is_driven(way, lane))


def _is_driven(way: Connection, lane: int) -> bool:
    # Whether the traffic of a lane goes the way that leads into it.
    opposing = way.roads.lanes.get(lane) in way.roads.road.opposing
    return lane in way.roads.lanes and opposing == (way.direction < 0)


def _build(way: Connection, lane: int) -> Way:
    roads, index = way.roads, way.roads.lanes[lane]
    stations = np.linspace(*way.span, max(2, 1 + int(np.ceil(np.ptp(way.span) / _STEP))))
    left, right = (
        np.stack(roads.line.to_plane(stations, border), axis=1) for border in roads.borders(index, stations)
    )
    if way.direction < 0:
        left, right = right[::-1], left[::-1]
    begin, end = roads.line.heading(np.array(way.span))[:: way.direction]
    turned = float(end - begin)
    turn = "straight" if abs(turned) < _TURN else "left" if turned > 0.0 else "right"
    heading = float(begin) + (np.pi if way.direction < 0 else 0.0)
    return Way(hash((id(roads), lane)), left, right, way.rank, heading, turn, way.lights)
