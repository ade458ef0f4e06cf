"""Evaluation of a storyboard's conditions, all particles at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Vehicles
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.driving.values import to_plane
from avrare.protocols import Bools, Floats
from avrare_openscenario.network import RoadMap
from avrare_openscenario.signals import UNSET
from avrare_openscenario.starts import move_along_body, move_over, nearest_lane, pick, place_point
from avrare_openscenario.story import Condition, Place
from avrare_openscenario.trajectories import list_places

_TOLERANCE = 1e-9
"""Relative difference below which numbers are equal: 3 x 0.1 s is no more than 0.3 s."""
_TURNED = 0.05
"""Most difference of the headings where one is given for a place that is reached [rad]."""


@dataclass(frozen=True)
class Traffic:
    """All vehicles at one step, the ego last.

    Attributes:
        time: (N,) [s].
        vehicles: States (N, V + 1).
        lengths: (V + 1,) [m].
        widths: (V + 1,) [m].
        ahead: (V + 1,) how far the middles are ahead of the points of reference [m].
        travelled: (N, V + 1) way so far [m].
        still: (N, V + 1) time at rest so far [s].
        variables: (N, P) values of variables.
    """

    time: Floats
    vehicles: Vehicles
    lengths: Floats
    widths: Floats
    ahead: Floats
    travelled: Floats
    still: Floats
    variables: Floats


def holds(
    condition: Condition,
    traffic: Traffic,
    maps: Sequence[RoadMap],
    table: Floats,
    acts: Bools,
    begun: NDArray[np.int64],
    ended: NDArray[np.int64],
    complete: Bools,
) -> Bools:
    """Tell (N,) where a condition holds, edges and delays aside.

    Args:
        condition: The condition.
        traffic: The vehicles.
        maps: The road of each vehicle.
        table: (N, K) numbers of the file.
        acts: (N, A) which acts have begun.
        begun: (N, E) step at which each event began, -1 before.
        ended: (N, E) step at which it ended, -1 before.
        complete: (N, E) which events have begun as often as they may, and ended.
    """
    value = table[:, condition.value]
    if condition.kind == "time":
        return compare(condition.rule, traffic.time, value)
    if condition.kind == "state":
        over = ended >= 0 if (condition.begin, condition.state) == ("event", "endTransition") else complete
        return _state_holds(condition, acts, begun, over)
    if condition.kind == "variable":
        return compare(condition.rule, traffic.variables[:, condition.variable], value)
    if condition.kind == "light":
        return _shows(condition, traffic, table)
    found = np.stack(
        [
            compare(condition.rule, _measure(condition, entity, traffic, maps, table), value)
            for entity in condition.entities
        ]
    )
    return np.asarray(found.all(axis=0) if condition.every else found.any(axis=0))


def compare(rule: str, left: Floats, right: Floats) -> Bools:
    """Tell where a comparison of OpenSCENARIO holds."""
    slack = _TOLERANCE * (1.0 + np.abs(right))
    verdicts = {
        "lessThan": left < right - slack,
        "lessOrEqual": left <= right + slack,
        "greaterThan": left > right + slack,
        "greaterOrEqual": left >= right - slack,
        "equalTo": np.abs(left - right) <= slack,
        "notEqualTo": np.abs(left - right) > slack,
    }
    return np.asarray(verdicts[rule])


def _shows(condition: Condition, traffic: Traffic, table: Floats) -> Bools:
    # Whether a traffic light shows a state, as an action set it or in the phase of its controller.
    state = traffic.variables[:, condition.variable]
    cycle, *times = (table[:, number] for number in condition.reach)
    clock = np.mod(traffic.time + traffic.variables[:, condition.other] + _TOLERANCE, cycle)
    spans = zip(times[::2], times[1::2], strict=True)
    inside = np.any([(begin <= clock) & (clock < end) for begin, end in spans], axis=0)
    return np.asarray(np.where(state == UNSET, inside, state == table[:, condition.value]))


def _state_holds(condition: Condition, acts: Bools, begun: NDArray[np.int64], over: Bools) -> Bools:
    events = list(condition.events)
    some = (begun[:, events] >= 0).any(axis=1)
    if condition.begin == "act":
        some = acts[:, condition.act]
    elif condition.begin == "story":
        some = np.ones(len(begun), np.bool_)
    all_ended = some & over[:, events].all(axis=1)
    match condition.state:
        case "standbyState":
            return np.asarray(~some)
        case "startTransition":
            return np.asarray(some)
        case "runningState":
            return np.asarray(some & ~all_ended)
    return np.asarray(all_ended)


def _measure(
    condition: Condition, entity: int, traffic: Traffic, maps: Sequence[RoadMap], table: Floats
) -> Floats:
    roads = maps[entity]
    speeds, other = traffic.vehicles.speed, condition.other
    match condition.kind:
        case "travelled":
            return traffic.travelled[:, entity]
        case "standstill":
            return traffic.still[:, entity]
        case "speed":
            return speeds[:, entity]
        case "acceleration":
            return traffic.vehicles.acceleration[:, entity]
        case "relative_speed":
            turned = traffic.vehicles.heading[:, other] - traffic.vehicles.heading[:, entity]
            if condition.direction == "longitudinal":
                return np.asarray(speeds[:, entity] - np.cos(turned) * speeds[:, other])
            if condition.direction == "lateral":
                return np.asarray(-np.sin(turned) * speeds[:, other])
            return np.asarray(speeds[:, entity] - speeds[:, other])
        case "collision":
            return _touches(condition, entity, traffic, maps)
        case "angle":
            return _turn_away(condition, entity, traffic, maps, table)
        case "clearance":
            return _is_clear(condition, entity, traffic, maps, table)
        case "road_end":
            station = _reference(roads, pick(traffic.vehicles, entity), traffic.ahead[entity]).x
            slack = _TOLERANCE * (1.0 + roads.line.length)
            return np.asarray((station <= slack) | (station >= roads.line.length - slack), dtype=np.float64)
        case "off_road":
            return _off_road(pick(traffic.vehicles, entity), roads)
    distance = _distance(condition, entity, traffic, maps, table)
    if condition.kind in ("distance", "reach"):
        return distance
    closing = speeds[:, entity]
    if condition.kind == "collision_time" and condition.place is None:
        along = speeds * np.cos(traffic.vehicles.heading)
        side = np.sign(traffic.vehicles.x[:, other] - traffic.vehicles.x[:, entity])
        closing = side * (along[:, entity] - along[:, other])
    moving = closing > _TOLERANCE
    return np.where(moving, distance / np.where(moving, closing, 1.0), np.inf)


def _distance(
    condition: Condition, one: int, traffic: Traffic, maps: Sequence[RoadMap], table: Floats
) -> Floats:
    # Distance of a vehicle to another one, or to a place.
    roads, here, other = maps[one], pick(traffic.vehicles, one), condition.other
    if condition.place is None:
        there, size = _see(traffic, other, roads, maps), (traffic.lengths[other], traffic.widths[other])
    else:
        there, size = _locate(condition.place, roads, traffic, maps, table), (0.0, 0.0)
    length, width = 0.5 * (traffic.lengths[one] + size[0]), 0.5 * (traffic.widths[one] + size[1])
    if condition.direction == "lateral":
        return np.asarray(np.maximum(np.abs(here.y - there.y) - (width if condition.free else 0.0), 0.0))
    if condition.free and condition.along:
        return np.asarray(np.maximum(np.abs(here.x - there.x) - length, 0.0))
    if condition.free:
        boxes = _box(roads, here, traffic.lengths[one], traffic.widths[one]), _box(roads, there, *size)
        return np.asarray(np.maximum(signed_distance(*boxes), 0.0))
    here = _reference(roads, here, traffic.ahead[one])
    if condition.place is None:
        return _apart(condition.along, here, _reference(roads, there, traffic.ahead[other]), roads)
    distance = _apart(condition.along, here, there, roads)
    turned = condition.kind == "reach" and condition.place.turned and condition.place.kind != "plane"
    aside = np.abs(np.remainder(here.heading - there.heading + np.pi, 2.0 * np.pi) - np.pi) > _TURNED
    return np.where(turned & aside, np.inf, distance)


def _locate(
    place: Place, roads: RoadMap, traffic: Traffic, maps: Sequence[RoadMap], table: Floats
) -> Vehicles:
    # A place as a vehicle that stands there.
    references = {}
    for k in list_places(place):
        seen = _reference(maps[k], pick(traffic.vehicles, k), traffic.ahead[k])
        references[k] = seen.x, seen.y, seen.heading
    s, d, heading = place_point(place, roads, maps, table, references)
    return Vehicles(s, d, heading, np.zeros_like(s), np.zeros_like(s))


def _see(traffic: Traffic, other: int, roads: RoadMap, maps: Sequence[RoadMap]) -> Vehicles:
    # Another vehicle along a road, which may not be its own.
    return move_over(pick(traffic.vehicles, other), maps[other], roads)


def _touches(condition: Condition, one: int, traffic: Traffic, maps: Sequence[RoadMap]) -> Floats:
    touches = np.zeros(len(traffic.time), np.bool_)
    roads, lengths, widths = maps[one], traffic.lengths, traffic.widths
    mine = _box(roads, pick(traffic.vehicles, one), lengths[one], widths[one])
    for other in condition.against:
        if other != one:
            theirs = _box(roads, _see(traffic, other, roads, maps), lengths[other], widths[other])
            touches |= signed_distance(mine, theirs) <= 0.0
    return touches.astype(np.float64)


def _is_clear(
    condition: Condition, one: int, traffic: Traffic, maps: Sequence[RoadMap], table: Floats
) -> Floats:
    roads, here = maps[one], pick(traffic.vehicles, one)
    ahead, behind = (table[:, number] for number in condition.reach)
    along = np.sign(np.cos(here.heading))
    lane, taken = nearest_lane(roads, here.y, here.x), np.zeros(len(here.x), np.bool_)
    for other in condition.against:
        if other == one:
            continue
        there = _see(traffic, other, roads, maps)
        way, size = along * (there.x - here.x), 0.0
        if condition.free:
            size = 0.5 * (traffic.lengths[one] + traffic.lengths[other])
        near = (way - size <= ahead) & (-way - size <= behind)
        beside = along * (nearest_lane(roads, there.y, there.x) - lane)
        inside = [(low <= beside) & (beside <= high) for low, high in condition.lanes]
        taken |= near & np.any(inside, axis=0) if inside else near
    return np.asarray(~taken, dtype=np.float64)


def _turn_away(
    condition: Condition, entity: int, traffic: Traffic, maps: Sequence[RoadMap], table: Floats
) -> Floats:
    # How far a heading is from the one that is asked for.
    found = -table[:, condition.reach[0]]
    for k, sign in ((entity, 1.0), (condition.other, -1.0)):
        if k >= 0:
            line = 0.0 if condition.along else maps[k].line.heading(traffic.vehicles.x[:, k])
            found = found + sign * (traffic.vehicles.heading[:, k] + line)
    return np.asarray(np.abs(np.remainder(found + np.pi, 2.0 * np.pi) - np.pi))


def _off_road(vehicle: Vehicles, roads: RoadMap) -> Floats:
    middles, reach = roads.middles(vehicle.x), 0.5 * roads.road.lane_width
    aside = (np.abs(vehicle.y[:, None] - middles) > reach).all(axis=1)
    return np.asarray(aside | (vehicle.x < 0.0) | (vehicle.x > roads.line.length), dtype=np.float64)


def _box(roads: RoadMap, vehicles: Vehicles, length: float, width: float) -> Rectangle:
    place = to_plane(roads.road, vehicles)
    return Rectangle(place.x, place.y, place.heading, np.asarray(length), np.asarray(width))


def _apart(along: bool, one: Vehicles, other: Vehicles, roads: RoadMap) -> Floats:
    if along:
        return np.asarray(np.abs(one.x - other.x))
    one, other = to_plane(roads.road, one), to_plane(roads.road, other)
    return np.hypot(one.x - other.x, one.y - other.y)


def _reference(roads: RoadMap, vehicles: Vehicles, ahead: Floats) -> Vehicles:
    # The point that a file speaks of: the middle of the rear axle.
    s, d, heading = move_along_body(roads, vehicles.x, vehicles.y, vehicles.heading, -ahead)
    return Vehicles(s, d, heading, vehicles.speed, vehicles.acceleration)
