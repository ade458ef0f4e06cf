"""State of a storyboard, and evaluation of its conditions, all particles at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.driving import Vehicles
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.driving.values import to_plane
from avrare.protocols import Bools, Floats
from avrare_openscenario.courses import Integers
from avrare_openscenario.motions import Drive
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import Body
from avrare_openscenario.signals import UNSET
from avrare_openscenario.starts import move_along_body, move_over, nearest_lane, pick, place_point
from avrare_openscenario.story import Condition, Place
from avrare_openscenario.trajectories import list_places

_TOLERANCE = 1e-9
"""Relative difference below which numbers are equal: 3 x 0.1 s is no more than 0.3 s."""
_TURNED = 0.05
"""Most difference of the headings where one is given for a place that is reached [rad]."""


@dataclass(frozen=True)
class StoryMemory:
    """State of a storyboard in N particles: C conditions, A acts, E events, V vehicles and the ego.

    Attributes:
        table: (N, K) numbers of the file.
        acts: (N, A) which acts have begun.
        stopped: (N, A) which were ended by their stop triggers.
        begun: (N, E) step at which an event began, -1 before.
        ended: (N, E) step at which it ended, -1 before.
        runs: (N, E) how often it began.
        rounds: (N, G) how often a maneuver group was executed.
        before: (N, C) 1 where a condition held at the last step, 0 where not, -1 before the first.
        late: (N, C, D) what held, edges included, at the last D steps, the newest first.
        travelled: (N, V + 1) way so far [m].
        still: (N, V + 1) time at rest so far [s].
        variables: (N, P) values of variables.
        drive: What the vehicles are doing.
        points: States (N, V) of their points of reference, each along its own road.
        bodies: The same of their middles.
    """

    table: Floats
    acts: Bools
    stopped: Bools
    begun: Integers
    ended: Integers
    runs: Integers
    rounds: Integers
    before: Integers
    late: Bools
    travelled: Floats
    still: Floats
    variables: Floats
    drive: Drive
    points: Vehicles
    bodies: Vehicles


@dataclass(frozen=True)
class Traffic:
    """All vehicles at one step, the ego last, and the storyboard until then.

    Attributes:
        time: (N,) [s].
        vehicles: States (N, V + 1).
        bodies: Bodies of the vehicles.
        maps: The road of each.
        memory: State of the storyboard.
        complete: (N, E) which events have begun as often as they may, and ended.
    """

    time: Floats
    vehicles: Vehicles
    bodies: Sequence[Body]
    maps: Sequence[RoadMap]
    memory: StoryMemory
    complete: Bools

    def see(self, index: int, roads: RoadMap) -> Vehicles:
        """Return a vehicle along a road, which may not be its own."""
        return move_over(pick(self.vehicles, index), self.maps[index], roads)

    def refer(self, index: int, roads: RoadMap) -> Vehicles:
        """Return the point of a vehicle that a file speaks of, along a road: the middle of the rear axle."""
        vehicle = self.see(index, roads)
        pose = move_along_body(roads, vehicle.x, vehicle.y, vehicle.heading, -self.bodies[index].ahead)
        return Vehicles(*pose, vehicle.speed, vehicle.acceleration)

    def outline(self, index: int, roads: RoadMap) -> Rectangle:
        """Return the box of a vehicle in the plane of a road."""
        return _box(roads, self.see(index, roads), self.bodies[index].length, self.bodies[index].width)


def holds(condition: Condition, traffic: Traffic) -> Bools:
    """Return a mask (N,) of the rows in which a condition holds, before edges and delays."""
    memory = traffic.memory
    value = memory.table[:, condition.value]
    match condition.kind:
        case "time":
            return compare(condition.rule, traffic.time, value)
        case "state":
            return _state_holds(condition, traffic)
        case "variable":
            return compare(condition.rule, memory.variables[:, condition.variable], value)
        case "light":
            return _shows(condition, traffic)
    measures = [_measure(condition, entity, traffic) for entity in condition.entities]
    verdicts = np.stack([compare(condition.rule, measure, value) for measure in measures])
    return np.asarray(verdicts.all(axis=0) if condition.every else verdicts.any(axis=0))


def compare(rule: str, left: Floats, right: Floats) -> Bools:
    """Return a mask of the rows in which a comparison of OpenSCENARIO holds."""
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


def _shows(condition: Condition, traffic: Traffic) -> Bools:
    # Whether a traffic light shows a state, as an action set it or in the phase of its controller.
    table, variables = traffic.memory.table, traffic.memory.variables
    state = variables[:, condition.variable]
    cycle, *times = (table[:, number] for number in condition.reach)
    clock = np.mod(traffic.time + variables[:, condition.other] + _TOLERANCE, cycle)
    spans = zip(times[::2], times[1::2], strict=True)
    inside = np.any([(begin <= clock) & (clock < end) for begin, end in spans], axis=0)
    return np.asarray(np.where(state == UNSET, inside, state == table[:, condition.value]))


def _state_holds(condition: Condition, traffic: Traffic) -> Bools:
    memory, events = traffic.memory, list(condition.events)
    some = (memory.begun[:, events] >= 0).any(axis=1)
    if condition.begin == "act":
        some = memory.acts[:, condition.act]
    elif condition.begin == "story":
        some = np.ones(len(memory.begun), np.bool_)
    ends = (condition.begin, condition.state) == ("event", "endTransition")
    over = memory.ended >= 0 if ends else traffic.complete
    all_ended = some & over[:, events].all(axis=1)
    match condition.state:
        case "standbyState":
            return np.asarray(~some)
        case "startTransition":
            return np.asarray(some)
        case "runningState":
            return np.asarray(some & ~all_ended)
    return np.asarray(all_ended)


def _measure(condition: Condition, entity: int, traffic: Traffic) -> Floats:
    vehicles, other = traffic.vehicles, condition.other
    speeds, headings = vehicles.speed, vehicles.heading
    match condition.kind:
        case "travelled":
            return traffic.memory.travelled[:, entity]
        case "standstill":
            return traffic.memory.still[:, entity]
        case "speed":
            return speeds[:, entity]
        case "acceleration":
            return vehicles.acceleration[:, entity]
        case "relative_speed":
            turned = headings[:, other] - headings[:, entity]
            if condition.direction == "longitudinal":
                return np.asarray(np.cos(turned) * speeds[:, entity] - speeds[:, other])
            if condition.direction == "lateral":
                return np.asarray(-np.sin(turned) * speeds[:, entity])
            return np.asarray(speeds[:, entity] - speeds[:, other])
        case "collision":
            return _touches(condition, entity, traffic)
        case "angle":
            return _turn_away(condition, entity, traffic)
        case "clearance":
            return _is_clear(condition, entity, traffic)
        case "road_end":
            roads = traffic.maps[entity]
            station, length = traffic.refer(entity, roads).x, roads.line.length
            slack = _TOLERANCE * (1.0 + length)
            return np.asarray((station <= slack) | (station >= length - slack), dtype=np.float64)
        case "off_road":
            return _off_road(pick(vehicles, entity), traffic.maps[entity])
    distance = _distance(condition, entity, traffic)
    if condition.kind in ("distance", "reach"):
        return distance
    closing = speeds[:, entity]
    if condition.kind == "collision_time" and condition.place is None:
        along = speeds * np.cos(headings)
        side = np.sign(vehicles.x[:, other] - vehicles.x[:, entity])
        closing = side * (along[:, entity] - along[:, other])
    moving = closing > _TOLERANCE
    return np.where(moving, distance / np.where(moving, closing, 1.0), np.inf)


def _distance(condition: Condition, entity: int, traffic: Traffic) -> Floats:
    # Distance of a vehicle to another one, or to a place.
    roads, place, other = traffic.maps[entity], condition.place, condition.other
    body, here = traffic.bodies[entity], pick(traffic.vehicles, entity)
    length, width = 0.0, 0.0
    if place is not None:
        there = _locate(place, roads, traffic)
    elif condition.free or condition.direction == "lateral":
        there = traffic.see(other, roads)
        length, width = traffic.bodies[other].length, traffic.bodies[other].width
    else:
        there = traffic.refer(other, roads)
    if condition.direction == "lateral":
        margin = 0.5 * (body.width + width) if condition.free else 0.0
        return np.asarray(np.maximum(np.abs(here.y - there.y) - margin, 0.0))
    if condition.free and condition.along:
        return np.asarray(np.maximum(np.abs(here.x - there.x) - 0.5 * (body.length + length), 0.0))
    if condition.free:
        boxes = traffic.outline(entity, roads), _box(roads, there, length, width)
        return np.asarray(np.maximum(signed_distance(*boxes), 0.0))
    here = traffic.refer(entity, roads)
    distance = _apart(condition.along, here, there, roads)
    turned = condition.kind == "reach" and place is not None and place.turned and place.kind != "plane"
    aside = np.abs(np.remainder(here.heading - there.heading + np.pi, 2.0 * np.pi) - np.pi) > _TURNED
    return np.where(turned & aside, np.inf, distance)


def _locate(place: Place, roads: RoadMap, traffic: Traffic) -> Vehicles:
    # A place as a vehicle that stands there.
    references = {}
    for k in list_places(place):
        point = traffic.refer(k, traffic.maps[k])
        references[k] = point.x, point.y, point.heading
    s, d, heading = place_point(place, roads, traffic.maps, traffic.memory.table, references)
    return Vehicles(s, d, heading, np.zeros_like(s), np.zeros_like(s))


def _touches(condition: Condition, entity: int, traffic: Traffic) -> Floats:
    touches, roads = np.zeros(len(traffic.time), np.bool_), traffic.maps[entity]
    box = traffic.outline(entity, roads)
    for other in condition.against:
        if other != entity:
            touches |= signed_distance(box, traffic.outline(other, roads)) <= 0.0
    return touches.astype(np.float64)


def _is_clear(condition: Condition, entity: int, traffic: Traffic) -> Floats:
    roads, here = traffic.maps[entity], pick(traffic.vehicles, entity)
    ahead, behind = (traffic.memory.table[:, number] for number in condition.reach)
    along = np.sign(np.cos(here.heading))
    lane, taken = nearest_lane(roads, here.y, here.x), np.zeros(len(here.x), np.bool_)
    for other in condition.against:
        if other == entity:
            continue
        there = traffic.see(other, roads)
        lengths = traffic.bodies[entity].length + traffic.bodies[other].length
        way, size = along * (there.x - here.x), 0.5 * lengths if condition.free else 0.0
        near = (way - size <= ahead) & (-way - size <= behind)
        aside = along * (nearest_lane(roads, there.y, there.x) - lane)
        inside = [(low <= aside) & (aside <= high) for low, high in condition.lanes]
        taken |= near & np.any(inside, axis=0) if inside else near
    return np.asarray(~taken, dtype=np.float64)


def _turn_away(condition: Condition, entity: int, traffic: Traffic) -> Floats:
    # How far a heading is from the one that is asked for.
    angle = -traffic.memory.table[:, condition.reach[0]]
    for k, sign in ((entity, 1.0), (condition.other, -1.0)):
        if k >= 0:
            line = 0.0 if condition.along else traffic.maps[k].line.heading(traffic.vehicles.x[:, k])
            angle = angle + sign * (traffic.vehicles.heading[:, k] + line)
    return np.asarray(np.abs(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi))


def _off_road(vehicle: Vehicles, roads: RoadMap) -> Floats:
    middles, reach = roads.middles(vehicle.x), 0.5 * roads.road.lane_width
    aside = (np.abs(vehicle.y[:, None] - middles) > reach).all(axis=1)
    return np.asarray(aside | (vehicle.x < 0.0) | (vehicle.x > roads.line.length), dtype=np.float64)


def _box(roads: RoadMap, vehicles: Vehicles, length: float, width: float) -> Rectangle:
    place = to_plane(roads.road, vehicles)
    return Rectangle(place.x, place.y, place.heading, np.asarray(length), np.asarray(width))


def _apart(along: bool, here: Vehicles, there: Vehicles, roads: RoadMap) -> Floats:
    if along:
        return np.asarray(np.abs(here.x - there.x))
    here, there = to_plane(roads.road, here), to_plane(roads.road, there)
    return np.hypot(here.x - there.x, here.y - there.y)
