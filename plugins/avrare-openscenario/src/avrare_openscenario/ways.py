"""Reference lines of vehicles in a simulated scene, reselected after lane changes, jumps and routes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats
from avrare_openscenario.courses import Course, put
from avrare_openscenario.network import Leg, RoadMap
from avrare_openscenario.routes import follow_lane
from avrare_openscenario.scenario_file import ScenarioFile
from avrare_openscenario.starts import lane_middle, nearest_lane, place_point
from avrare_openscenario.story import LaneChange, Place
from avrare_openscenario.trajectories import Pose

_AHEAD = 1.0
"""Way before the end of its line at which a vehicle looks further [m]."""
_BEYOND = 100.0
"""Way beyond that end from which on it looks no more [m]."""
_EDGE = 5e-10
"""Way before the end of a road at which a vehicle stands for a step before it is at the end [m]."""


class Ways:
    """Lines of the vehicles of one scene, which change as they drive on."""

    def __init__(self, file: ScenarioFile) -> None:
        self.network, self.maps, self.routes = file.network, list(file.maps), dict(file.story.routes)
        self.changed: set[int] = set()
        self.off, self.landed = set[int](), set[int]()

    def assign(self, vehicle: int, roads: Sequence[RoadMap]) -> None:
        """Give a vehicle a route, which it takes as soon as it changes no lane."""
        self.routes[vehicle] = roads
        self.changed.add(vehicle)

    def jump(self, vehicle: int, place: Place, table: Floats, others: dict[int, Pose]) -> None:
        """Put a vehicle on the line of the place that it is put to."""
        roads = place.roads
        if roads is None and place.other >= 0:
            roads = self.maps[place.other]
        elif roads is None:
            line = self.maps[vehicle].line
            s, d, _ = place_point(place, self.maps[vehicle], self.maps, table, others)
            x, y = (table[:, place.x], table[:, place.y]) if place.kind == "plane" else line.to_plane(s, d)
            roads = self.network.find_nearest(float(x[0]), float(y[0]))
        self.maps[vehicle] = roads
        self.changed.add(vehicle)

    def renew(self, points: Vehicles, course: Course, follows: Sequence[bool]) -> tuple[Vehicles, Course]:
        """Return points of reference (1, V) and lane changes along the lines that vehicles take from here.

        Args:
            points: States (1, V).
            course: Lane changes under way.
            follows: Whether each vehicle follows a trajectory, and so keeps its line.
        """
        self.landed = {k for k in self.off if not follows[k]}  # a trajectory may end on another road
        self.off = set(np.flatnonzero(follows).tolist())
        self.changed |= self.landed
        for k, roads in enumerate(self.maps):
            station = float(points.x[0, k])
            if roads.legs and not follows[k] and self._leaves(k, roads, station, points):
                self.changed.add(k)
            if k in self.changed and not follows[k]:
                self.changed.remove(k)
                before, y = points, points.y[0, k]
                points = self._renew(k, points)
                side = np.sign(np.cos(points.heading[0, k] - before.heading[0, k]))
                course = course.carry_over(k, y, points.y[0, k], side)
        return points, course

    def stop(self, before: Vehicles, points: Vehicles, follows: Sequence[bool]) -> Vehicles:
        """Return points of reference (1, V); vehicles that reach the end of a road stop there.

        Args:
            before: States (1, V) one step ago.
            points: States now.
            follows: Whether each vehicle follows a trajectory, and so keeps no road.
        """
        ends = np.array([roads.line.length for roads in self.maps])
        free = [follows[k] or roads.closed or not roads.lanes for k, roads in enumerate(self.maps)]
        x, was = points.x[0], before.x[0]
        stops = ~np.array(free) & (was >= 0.0) & (was <= ends) & ((x < 0.0) | (x > ends))
        for k in np.flatnonzero(stops):
            leg = self.maps[k].find_leg(was[k]) if self.maps[k].legs else None
            stops[k] = leg is None or not self.network.find_ways(leg.roads, leg.direction)
        stood = stops & ((was <= 0.0) | (was >= ends))
        edge = np.where((was > 2.0 * _EDGE) & (was < ends - 2.0 * _EDGE), _EDGE, 0.0)
        return replace(
            points,
            x=np.where(stops, np.clip(x, edge, ends - edge), points.x),
            speed=np.where(stood, 0.0, points.speed),
        )

    def _leaves(self, k: int, roads: RoadMap, station: float, points: Vehicles) -> bool:
        # Whether the way ends, or goes on from another lane than the one in which the vehicle is.
        leg, after = roads.find_leg(station), roads.find_leg(station + _AHEAD)
        if station + _AHEAD > roads.line.length:
            ways = self.network.find_ways(leg.roads, leg.direction)
            return bool(ways) and station < roads.line.length + _BEYOND
        if leg is after:
            return False
        place = self._find_leg(k, points)[0]
        return place is not None and place.lane != leg.lane

    def _renew(self, k: int, points: Vehicles) -> Vehicles:
        leg, (s, d, heading) = self._find_leg(k, points)
        if leg is None:
            return points
        x, y = leg.roads.line.to_plane(s, d)
        turned = heading + leg.roads.line.heading(s)
        line = leg.roads
        if not line.closed and (self.network.find_ways(line, leg.direction) or line.bends(leg.lane)):
            line = follow_lane(self.network, line, leg.lane, self.routes.get(k, ()), leg.direction)
        s, d = line.line.to_road(x, y)
        if not np.isfinite(s[0]):
            return points
        self.maps[k] = line
        return put(points, k, True, x=s, y=d, heading=turned - line.line.heading(s))

    def find_target(self, action: LaneChange, points: Vehicles, offset: Floats) -> Floats:
        """Return the offset (1,) at which a lane change ends, from the vehicle's reference line."""
        leg, (s, d, _) = self._find_leg(action.actor, points)
        now = points.y[:, action.actor]
        if leg is None:
            return now + offset
        other, pose = self._find_leg(action.reference, points)
        if other is None:
            return now
        apart = action.exact and other.roads is not leg.roads
        target = d if apart else aim_across(action, leg.roads, s, other.roads, pose)
        y = self.maps[action.actor].line.to_road(*leg.roads.line.to_plane(s, target + offset))[1]
        return np.where(np.isfinite(y), y, now)

    def _find_leg(self, k: int, points: Vehicles) -> tuple[Leg | None, Pose]:
        # The lane in which a vehicle is, and its pose along the roads of that lane.
        roads, station = self.maps[k], points.x[:, k]
        x, y = roads.line.to_plane(station, points.y[:, k])
        turned = points.heading[:, k] + roads.line.heading(station)
        if roads.legs and k not in self.landed:
            roads = roads.find_leg(float(station[0])).roads
        elif roads not in self.network.maps or k in self.landed:
            roads = self.network.find_nearest(float(x[0]), float(y[0]))
        s, d = roads.line.to_road(x, y)
        heading = turned - roads.line.heading(s)
        if not np.isfinite(s[0]) or not roads.lanes:
            return None, (s, d, heading)
        lane = roads.name_lane(int(nearest_lane(roads, d, s)[0]))
        return Leg(roads, lane, 1 if np.cos(heading[0]) >= 0.0 else -1), (s, d, heading)


def aim_across(action: LaneChange, roads: RoadMap, s: Floats, other: RoadMap, pose: Pose) -> Floats:
    """Return y (N,) at which a lane change ends, its own offset aside."""
    their_s, their_d, heading = pose
    if action.exact:
        return their_d
    lane = np.full(len(s), roads.lanes.get(action.lane, -1))
    if action.other >= 0:
        along = np.sign(np.cos(heading)).astype(np.int64)
        lane = nearest_lane(other, their_d, their_s) + along * action.lane
        if other is not roads:  # the lane of the same id
            lane = np.array([roads.lanes.get(other.name_lane(index), -1) for index in lane.tolist()])
    return lane_middle(roads, lane, s)
