"""Ways through junctions: the centre of a lane, from road to road, as one line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import PolygonalLine
from avrare.protocols import Floats
from avrare_openscenario.curves import go_on
from avrare_openscenario.network import Connection, Leg, Network, RoadMap

_LONGEST = 3000.0
"""Way after which a line ends [m]."""
_STEP = 0.5
"""Distance of its points [m]."""


def follow_lane(
    network: Network, roads: RoadMap, lane: int, wanted: Sequence[RoadMap], direction: int = 0
) -> RoadMap:
    """Return the way of a vehicle from its lane on: over the wanted roads, else with the least turns.

    Args:
        network: All roads.
        roads: Those of the lane.
        lane: Its id.
        wanted: Roads to be reached one after another.
        direction: Whether it is driven along (1) or against (-1) the roads; 0: as its traffic goes.
    """
    index, first = roads.lanes[lane], roads.road
    direction = direction or (-1 if index in first.opposing else 1)
    goals = _list_goals(network, Leg(roads, lane, direction), wanted)
    legs, begin = [Leg(roads, lane, direction)], 0.0
    points: list[Floats] = []
    while True:
        points.append(go_on(points, _sample(legs[-1])))
        begin = float(np.hypot(*np.diff(np.concatenate(points), axis=0).T).sum())
        goals = goals[1:] if goals and legs[-1].roads is goals[0] else goals
        after = _find_next(network, legs[-1], goals) if begin < _LONGEST else None
        if after is None:
            break
        legs.append(replace(after, begin=begin))
    line = PolygonalLine(np.concatenate(points))
    own = first.lane_centres[index]
    order = range(len(first.lane_centres))[::direction]
    names = {place: name for name, place in roads.lanes.items()}
    road = Road(
        tuple(direction * (first.lane_centres[k] - own) for k in order),
        first.lane_width,
        begin=0.0,
        end=line.length,
        line=line,
        opposing=tuple(new for new, k in enumerate(order) if (k in first.opposing) != (direction < 0)),
    )
    lanes = {names[k]: new for new, k in enumerate(order)}
    return RoadMap(road, line, {}, lanes, {}, legs=tuple(legs))


def _sample(leg: Leg) -> Floats:
    line = leg.roads.line
    stations = np.linspace(0.0, line.length, max(2, 1 + math.ceil(line.length / _STEP)))[:: leg.direction]
    across = leg.roads.middles(stations)[:, leg.roads.lanes[leg.lane]]
    kept = np.isfinite(across)
    return np.stack(line.to_plane(stations[kept], across[kept]), axis=1)


def _list_goals(network: Network, leg: Leg, wanted: Sequence[RoadMap]) -> Sequence[RoadMap]:
    # The wanted roads that are still to be reached: from the nearest one on.
    counts = [_count_legs(network, leg, goal) for goal in wanted]
    nearest = min(range(len(wanted)), key=lambda k: (counts[k], -k), default=0)
    return list(wanted[nearest:]) if counts and math.isfinite(counts[nearest]) else ()


def _count_legs(network: Network, leg: Leg, goal: RoadMap) -> float:
    # Lines of roads from one to another.
    front, seen, count = [(leg.roads, leg.direction)], set[tuple[int, int]](), 0
    while front:
        if any(roads is goal for roads, _ in front):
            return count
        seen |= {(id(roads), direction) for roads, direction in front}
        ways = [way for roads, direction in front for way in network.find_ways(roads, direction)]
        following = {(id(way.roads), way.direction): (way.roads, way.direction) for way in ways}
        front = [after for name, after in following.items() if name not in seen]
        count += 1
    return math.inf


def _find_next(network: Network, leg: Leg, goals: Sequence[RoadMap]) -> Leg | None:
    ways = [way for way in network.find_ways(leg.roads, leg.direction) if _leads_on(way)]
    own = [way for way in ways if way.lanes.get(leg.lane) in way.roads.lanes]

    def rank(way: Connection) -> tuple[float, bool, float]:
        far = _count_legs(network, Leg(way.roads, 0, way.direction), goals[0]) if goals else 0.0
        return far, way not in own, abs(_turn(way.roads))

    best = min(ways if goals else own, key=rank, default=None)
    if best is None or (best not in own and not math.isfinite(rank(best)[0])):
        return None
    lane = min(
        (name for name in best.lanes if best.lanes[name] in best.roads.lanes),
        key=lambda name: abs(name - leg.lane),
    )
    return Leg(best.roads, best.lanes[lane], best.direction)


def _leads_on(way: Connection) -> bool:
    return any(lane in way.roads.lanes for lane in way.lanes.values())


def _turn(roads: RoadMap) -> float:
    begin, end = roads.line.heading(np.array([0.0, roads.line.length]))
    return float(end - begin)
