"""Ways through junctions: the centre of a lane as one line, and where it meets ways that have priority."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import PolygonalLine
from avrare.protocols import Floats
from avrare_openscenario.curves import go_on
from avrare_openscenario.network import Connection, Leg, Network, RoadMap
from avrare_recordings.roads.ways import Way, find_crossing

_STEP = 0.5
"""Distance of its points, and of those of a border [m]."""


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
        longest = 3000.0  # way after which a line ends [m]
        after = _find_next(network, legs[-1], goals) if begin < longest else None
        if after is None:
            break
        legs.append(replace(after, begin=begin))
    line = PolygonalLine(np.concatenate(points))
    centre = first.lane_centres[index]
    order = range(len(first.lane_centres))[::direction]
    names = {place: name for name, place in roads.lanes.items()}
    road = Road(
        tuple(direction * (first.lane_centres[k] - centre) for k in order),
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
    inside = np.isfinite(across)
    return np.stack(line.to_plane(stations[inside], across[inside]), axis=1)


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
    straight = [way for way in ways if way.lanes.get(leg.lane) in way.roads.lanes]

    def rank(way: Connection) -> tuple[float, bool, float]:
        far = _count_legs(network, Leg(way.roads, 0, way.direction), goals[0]) if goals else 0.0
        return far, way not in straight, abs(_turn(way.roads))

    best = min(ways if goals else straight, key=rank, default=None)
    if best is None or (best not in straight and not math.isfinite(rank(best)[0])):
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


def add_crossings(network: Network, roads: RoadMap) -> RoadMap:
    """Return a way through junctions with its stop signs, and the areas in which others have priority."""
    areas, stops = [], []
    for before, after in pairwise(roads.legs):
        incoming = id(before.roads), before.direction
        for way in network.find_ways(before.roads, before.direction):
            if way.junction and way.roads is after.roads and way.lanes.get(before.lane) == after.lane:
                passage = _build(way, after.lane)
                stops += [after.begin] if way.rank < 0 else []
                others = _list_others(network, way.junction, incoming)
                areas += [find_crossing(roads.line, passage, other) for other in others]
    crossings = tuple(area for area in areas if area is not None)
    return replace(roads, road=replace(roads.road, crossings=crossings, stop_signs=tuple(stops)))


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
    least_turn = 0.25 * np.pi  # least turn of a way that is not straight on [rad]
    turn = "straight" if abs(turned) < least_turn else "left" if turned > 0.0 else "right"
    heading = float(begin) + (np.pi if way.direction < 0 else 0.0)
    return Way(hash((id(roads), lane)), left, right, way.rank, heading, turn, way.lights)
