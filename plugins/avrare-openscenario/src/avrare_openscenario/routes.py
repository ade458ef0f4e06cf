"""Ways through junctions: the centre of a lane, from road to road, as one line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import PolygonalLine
from avrare.protocols import Floats
from avrare_openscenario.opendrive import Network, RoadMap

_LONGEST = 3000.0
"""Way after which a line ends [m]."""
_STEP = 0.5
"""Distance of its points [m]."""


@dataclass(frozen=True)
class _Leg:
    # A lane of a line of roads, driven along it (1) or against it (-1).
    roads: RoadMap
    lane: int
    direction: int


def follow_lane(network: Network, roads: RoadMap, lane: int, wanted: Sequence[RoadMap]) -> RoadMap:
    """Return the way of a vehicle from its lane on: over the wanted roads, else with the least turns."""
    direction = -1 if roads.lanes[lane] in roads.road.opposing else 1
    legs = [_Leg(roads, lane, direction)]
    length = roads.line.length
    while length < _LONGEST and (leg := _find_next(network, legs[-1], wanted)) is not None:
        legs.append(leg)
        length += leg.roads.line.length
    line = PolygonalLine(np.concatenate([_sample(leg) for leg in legs]))
    index, first = roads.lanes[lane], roads.road
    own = first.lane_centres[index]
    order = range(len(first.lane_centres))[::direction]
    names = {place: name for name, place in roads.lanes.items()}
    road = Road(
        tuple(direction * (first.lane_centres[k] - own) for k in order),
        first.lane_width,
        begin=0.0,
        end=line.length,
        line=line,
        opposing=tuple(
            new for new, k in enumerate(order) if (k in first.opposing) != (index in first.opposing)
        ),
    )
    lanes = {names[k]: new for new, k in enumerate(order)}
    return RoadMap(road, line, {}, lanes, {})


def _sample(leg: _Leg) -> Floats:
    line = leg.roads.line
    stations = np.linspace(0.0, line.length, max(2, 1 + math.ceil(line.length / _STEP)))[:: leg.direction]
    across = leg.roads.middles(stations)[:, leg.roads.lanes[leg.lane]]
    kept = np.isfinite(across)
    return np.stack(line.to_plane(stations[kept], across[kept]), axis=1)


def _find_next(network: Network, leg: _Leg, wanted: Sequence[RoadMap]) -> _Leg | None:
    legs = [
        _Leg(connection.roads, connection.lanes.get(leg.lane, 0), connection.direction)
        for connection in network.connections.get((id(leg.roads), leg.direction), ())
    ]
    legs = [after for after in legs if after.lane in after.roads.lanes]
    if not legs:
        return None

    def rank(after: _Leg) -> tuple[bool, float]:
        later = network.connections.get((id(after.roads), after.direction), ())
        leads = after.roads in wanted or any(connection.roads in wanted for connection in later)
        return not leads, abs(_turn(after))

    return min(legs, key=rank)


def _turn(leg: _Leg) -> float:
    begin, end = leg.roads.line.heading(np.array([0.0, leg.roads.line.length]))
    return float(end - begin)
