"""Motions of vehicles along a road: what actions do, step by step, all particles at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_openscenario import speeds, story
from avrare_openscenario.courses import Course, Integers, put, transition_span
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import ScenarioFile
from avrare_openscenario.starts import build_path, move_over, pick, place_point, resolve_speed
from avrare_openscenario.trajectories import Path, Pose, list_places
from avrare_openscenario.ways import Ways, aim_across

_CRAWL = 0.5
"""Speed below which a heading does not follow a lane change [m/s]."""
GONE = 1e6
"""Station of a vehicle that is taken out [m]."""


@dataclass(frozen=True)
class Drive:
    """Motions of V vehicles of N particles.

    Attributes:
        heading: (N, V) heading of the bodies against their lanes, lane changes aside [rad].
        speed: Changes of speed.
        across: Changes of offset, and trajectories.
        stands: (N, V) whether a vehicle was put to its place in this step, and so goes no way.
        anchors: (N, T, V + 1, 3) poses of all points of reference where each trajectory began.
    """

    heading: Floats
    speed: Course
    across: Course
    stands: Bools
    anchors: Floats


class Motions:
    """Motions of the vehicles of a file."""

    def __init__(self, file: ScenarioFile, dt: float) -> None:
        self.story, self.dt = file.story, dt
        self.maps: Sequence[RoadMap] = file.maps
        self.ways: Ways | None = None
        self.bodies = file.bodies
        actions = list(enumerate(self.story.actions))
        self.trajectories = [number for number, action in actions if isinstance(action, story.Trajectory)]
        # Offsets cost no way along the road.
        changes = [(number, action) for number, action in actions if isinstance(action, story.LaneChange)]
        self.offsets = [number for number, action in changes if action.transition.dimension == "curvature"]
        others = file.maps[: len(file.bodies) - file.ego]
        self.free = np.array([not roads.lanes for roads in others], np.bool_)

    def begin(
        self, number: int, rows: Bools, table: Floats, drive: Drive, every: Vehicles
    ) -> tuple[Drive, Vehicles]:
        """Begin an action in some rows; what is done after it, and all points of reference."""
        action = self.story.actions[number]
        assert not isinstance(action, story.Assignment | story.Route)
        actor = action.actor
        match action:
            case story.SpeedChange():
                start, form = every.speed[:, actor], story.FORMS.index(action.transition.form)
                target, span = self._find_span(action, start, table, every)
                speed = drive.speed.begin(number, actor, rows, start, target, span, form)
                if action.transition.form == "step":
                    every = put(every, actor, rows, speed=speed.target[:, actor])
                return replace(drive, speed=speed), every
            case story.LaneChange():
                across = self._begin_across(drive.across, number, action, rows, table, every)
                return replace(drive, across=across), every
            case story.Teleport():
                every = self.put(action, table, every, rows)
                heading, stands = np.array(drive.heading), np.array(drive.stands)
                heading[rows, actor], stands[rows, actor] = every.heading[rows, actor], True
                across = drive.across.finish(actor, rows)
                return replace(drive, heading=heading, across=across, stands=stands), every
            case story.Removal():
                speed, across = (course.finish(actor, rows) for course in (drive.speed, drive.across))
                gone = put(every, actor, rows, x=GONE, speed=0.0)
                return replace(drive, speed=speed, across=across), gone
            case story.Gap(acceleration=None, continuous=False, across=False):
                return drive, self.put(action, table, every, rows)
            case story.Trajectory():
                anchors, poses = np.array(drive.anchors), np.stack([every.x, every.y, every.heading], axis=2)
                anchors[rows, self.trajectories.index(number)] = poses[rows]
                drive = replace(drive, anchors=anchors)
                path, begin = self._path(number, table, drive), np.zeros(len(rows))
                gear = path.gear(begin if action.begin is None else table[:, action.begin])
                turns = action.may_reverse & (every.speed[:, actor] < 0.0)  # it drives the line backwards
                gear = np.where(turns, -1.0, gear)
                turn = np.where(turns, np.pi, 0.0)
                across = drive.across.begin(number, actor, rows, gear, turn, by_way=not action.times)
                speed = drive.speed.finish(actor, rows) if action.times else drive.speed
                return replace(drive, speed=speed, across=across), every
            case story.Gap(across=True):
                across = drive.across.begin(number, actor, rows, every.y[:, actor], every.y[:, actor])
                return replace(drive, across=across), every
            case story.Gap() | story.SpeedProfile() | story.Synchronize():
                now, slope = every.speed[:, actor], every.acceleration[:, actor]
                target = slope if isinstance(action, story.SpeedProfile) else now  # it begins with that slope
                return replace(drive, speed=drive.speed.begin(number, actor, rows, now, target)), every
        raise AssertionError(action)

    def put(
        self, action: story.Gap | story.Teleport, table: Floats, every: Vehicles, rows: Bools | bool = True
    ) -> Vehicles:
        """Put a vehicle to its place, or to its distance with the other's speed, in some rows."""
        actor = action.actor
        if isinstance(action, story.Gap):
            place = speeds.place_gap(action, self.bodies, table, self._see(action, every))
            if action.across:
                return put(every, actor, rows, y=place)
            return put(every, actor, rows, x=place, speed=every.speed[:, action.other])
        references = self._references(action.place, every)
        if self.ways is not None:
            self.ways.jump(actor, action.place, table, references)
        s, d, heading = place_point(action.place, self.maps[actor], self.maps, table, references)
        return put(every, actor, rows, x=s, y=d, heading=heading)

    def move(self, table: Floats, drive: Drive, step: Integers, every: Vehicles) -> tuple[Drive, Vehicles]:
        """Return what is done, and the points of reference (N, V) without the ego's, one step later.

        A speed is that of the point in any direction: who changes lanes gains less along the road.
        """
        heading, speed, across = drive.heading, drive.speed, drive.across
        others = pick(every, slice(heading.shape[1]))
        active = speed.action >= 0
        speed = begun = self._aim(table, speed, every)
        speed, wanted, _ = speed.advance(self.dt, np.zeros_like(others.speed))
        over = self.free & (across.action < 0) & np.isinf(across.span)  # nobody drives on without a lane
        velocity = np.where(active, wanted, np.where(over, 0.0, others.speed))
        speed, velocity = self._steer(table, begun, speed, drive, velocity, every)
        changing = across.action >= 0
        moves = changing & ~np.isin(across.action, self.offsets)
        way = 0.5 * (np.where(active & (begun.span <= 0.0), velocity, others.speed) + velocity)
        if self.ways is not None:  # as players do: the speed of the whole step, and one action after another
            way = np.where(moves & (across.action < begun.action), others.speed, velocity)
        way = np.where(drive.stands & ~moves, 0.0, way * self.dt)
        ahead = np.abs(way * np.cos(others.heading - heading))  # a lane change goes along the road
        gone = np.where(np.isin(across.action, self.trajectories), across.start * way, ahead)
        across, aside, slope = across.advance(self.dt, gone)
        y = np.where(changing, aside, others.y + np.where(self.free, way * np.sin(heading), 0.0))
        direction = np.where(np.cos(heading) < 0.0, -1.0, 1.0)
        moving = changing & (np.abs(velocity) > _CRAWL)
        drift = np.where(across.by_way, slope, slope / np.where(moving, velocity, 1.0))
        drift = np.where(across.by_way, drift / np.hypot(1.0, drift), drift)
        angle = np.arcsin(np.clip(np.where(moving, drift, 0.0), -1.0, 1.0))
        along = np.where(self.free, np.cos(heading), direction * np.where(moves, np.cos(angle), 1.0))
        x = self._advance(others.x, 0.5 * (others.y + y), along * way)
        turned = heading + direction * angle
        points = Vehicles(x, y, turned, velocity, (velocity - others.speed) / self.dt)
        drive = replace(drive, speed=speed, across=across, stands=np.zeros_like(drive.stands))
        return self._follow(table, drive, step, every, points)

    def _advance(self, x: Floats, y: Floats, way: Floats) -> Floats:
        # Stations after a way along the roads, each vehicle on its own.
        moved = x + way
        for roads in dict.fromkeys(self.maps[: x.shape[1]]):
            columns = [k for k, other in enumerate(self.maps[: x.shape[1]]) if other is roads]
            if (line := roads.road.line) is not None:
                moved[:, columns] = line.advance(x[:, columns], y[:, columns], way[:, columns])
            if roads.closed:
                moved[:, columns] %= roads.line.length
        return moved

    def _aim(self, table: Floats, course: Course, every: Vehicles) -> Course:
        # Changes to speeds of others, who may change theirs.
        for number, action in enumerate(self.story.actions):
            if isinstance(action, story.SpeedChange) and action.target.other >= 0:
                target, span = self._find_span(action, course.start[:, action.actor], table, every)
                rows = course.action[:, action.actor] == number
                course = put(course, action.actor, rows, target=target, span=span)
        return course

    def _find_span(
        self, action: story.SpeedChange, now: Floats, table: Floats, every: Vehicles
    ) -> tuple[Floats, Floats]:
        # The speed that is wanted, and the time that it takes.
        body = self.bodies[action.actor]
        top = np.inf if body.speed_max is None else body.speed_max
        target = np.clip(resolve_speed(action.target, table, every.speed), -top, top)
        transition, value = action.transition, table[:, action.transition.value]
        if transition.form != "step" and transition.dimension == "distance":
            with np.errstate(divide="ignore", invalid="ignore"):  # the way's time at the mean of both speeds
                span = 2.0 * value / np.abs(now + target)
        else:
            span = transition_span(transition, target - now, value)
        if transition.form != "step":
            fastest = np.where(target >= now, *body.rates)
            limit = replace(transition, dimension="rate")
            span = np.maximum(span, transition_span(limit, target - now, fastest))
        return target, span

    def _begin_across(
        self,
        course: Course,
        number: int,
        action: story.LaneChange,
        rows: Bools,
        table: Floats,
        every: Vehicles,
    ) -> Course:
        actor, other, transition = action.actor, action.reference, action.transition
        now, offset = every.y[:, actor], table[:, action.offset]
        if self.ways is not None:
            target = self.ways.find_target(action, every, offset)
        else:
            roads, station, pose = self.maps[actor], every.x[:, actor], _pose(every, other)
            target = aim_across(action, roads, station, self.maps[other], pose) + offset
        span = transition_span(transition, target - now, table[:, transition.value])
        by_way = transition.dimension == "distance"
        return course.begin(
            number, actor, rows, now, target, span, story.FORMS.index(transition.form), by_way
        )

    def _steer(
        self, table: Floats, begun: Course, course: Course, drive: Drive, velocity: Floats, every: Vehicles
    ) -> tuple[Course, Floats]:
        # Speeds of actions that look at others, or at a table of times.
        velocity = np.array(velocity)
        for number, action in enumerate(self.story.actions):
            if isinstance(action, story.Assignment) or action.actor >= velocity.shape[1]:
                continue
            actor = action.actor
            rows = begun.action[:, actor] == number
            if (isinstance(action, story.SpeedChange) and not action.continuous) or not rows.any():
                continue
            clock = begun.clock[:, actor] + self.dt
            over = np.zeros(len(rows), np.bool_)
            match action:
                case story.SpeedChange():
                    course, value = put(course, actor, rows, action=number), velocity[:, actor]
                case story.SpeedProfile():
                    begin = begun.start[:, actor], begun.target[:, actor]
                    value, over = speeds.follow_profile(action, table, *begin, clock)
                case story.Gap():
                    seen = self._see(action, every)
                    value, over = speeds.close_gap(action, self.bodies, table, seen, self.dt)
                case story.Synchronize():
                    value, over = self._synchronize(action, table, drive, every)
                case _:
                    continue
            velocity[:, actor] = np.where(rows, value, velocity[:, actor])
            course = course.finish(actor, rows & over)
        return course, velocity

    def _synchronize(
        self, action: story.Synchronize, table: Floats, drive: Drive, every: Vehicles
    ) -> tuple[Floats, Bools]:
        way = self._way_to(action.target, action.actor, table, drive, every) - table[:, action.tolerance]
        master_way = self._way_to(action.master_target, action.master, table, drive, every)
        master_way = master_way - table[:, action.master_tolerance]
        final = None if action.final is None else resolve_speed(action.final, table, every.speed)
        steady = np.zeros(len(table)) if action.steady is None else table[:, action.steady]
        if action.steady_timed and final is not None:
            steady = steady * final
        now, pace = every.speed[:, action.actor], np.abs(every.speed[:, action.master])
        value = speeds.synchronize_speed(now, pace, way, master_way, final, steady, self.dt)
        over = (way < 0.0) | (master_way < pace * self.dt)
        return np.where(over & (final is not None), now if final is None else final, value), over

    def _way_to(
        self, place: story.Place, vehicle: int, table: Floats, drive: Drive, every: Vehicles
    ) -> Floats:
        roads, others = self.maps[vehicle], self._references(place, every)
        base = roads if place.roads is None or place.other >= 0 else place.roads
        x, y = base.line.to_plane(*place_point(place, base, self.maps, table, others)[:2])
        s, _ = roads.line.to_road(x, y)
        here_s, here_d, heading = _pose(every, vehicle)
        here_x, here_y = roads.line.to_plane(here_s, here_d)
        if vehicle >= drive.heading.shape[1] and place.curve is not None:  # the ego and its way
            path = build_path(place.curve, roads, self.maps, table, others)
            return path.project(x, y) - path.project(here_x, here_y)
        along = (s - here_s) * np.sign(np.cos(heading))
        aside = np.abs(np.sin(heading)) > np.sqrt(0.5)
        way = np.where(aside | np.isnan(along), np.hypot(x - here_x, y - here_y), along)
        for number, action in enumerate(self.story.actions):
            if isinstance(action, story.Trajectory) and action.actor == vehicle < drive.heading.shape[1]:
                rows = drive.across.action[:, vehicle] == number
                if rows.any():
                    path = self._path(number, table, drive)
                    way = np.where(rows, path.project(x, y) - path.project(here_x, here_y), way)
        return np.asarray(way)

    def _follow(
        self, table: Floats, drive: Drive, step: Integers, every: Vehicles, points: Vehicles
    ) -> tuple[Drive, Vehicles]:
        # Vehicles on trajectories, or at a distance across.
        heading, across = np.array(drive.heading), drive.across
        for number, action in enumerate(self.story.actions):
            if not isinstance(action, story.Trajectory | story.Gap) or action.actor >= points.x.shape[1]:
                continue
            rows = across.action[:, action.actor] == number
            if not rows.any():
                continue
            actor = action.actor
            clock, velocity, over = (
                across.clock[:, actor],
                points.speed[:, actor],
                np.zeros(len(rows), np.bool_),
            )
            if isinstance(action, story.Gap) and not action.by_body:
                rows = rows & (clock > 1.5 * self.dt)  # it begins a step later, as players do
                points, over = self._keep_aside(action, rows, clock, table, every, points)
                across = across.finish(actor, rows & over)
                continue
            if isinstance(action, story.Gap):
                other, pose = (self._see_in_plane(k, every) for k in (action.other, actor))
                x, y, turn = speeds.steer_beside(action, self.bodies, table, other, pose, velocity, self.dt)
            else:
                path = self._path(number, table, drive)
                begin = 0.0 if action.begin is None else table[:, action.begin]
                way = clock + begin
                backwards = across.start[:, actor] * velocity < 0.0
                over = np.where(backwards, way <= 1e-9, way >= path.ways[:, -1] - 1e-9)
                if action.times:
                    time = (step + 1) * self.dt if action.absolute else clock
                    times = table[:, list(action.times)]
                    way, velocity = path.when(times, np.asarray(time, dtype=np.float64))
                    over = time >= times[:, -1] - 1e-9
                    velocity = velocity * path.gear(way)
                x, y, turn = path.at(way)
                turn = turn + across.target[:, actor]
            roads = self.maps[actor]
            s, d = roads.line.to_road(x, y)
            turn = turn - roads.line.heading(s)
            points = put(points, actor, rows, x=s, y=d, heading=turn, speed=velocity)
            snapped = turn if self.free[actor] else np.where(np.cos(turn) < 0.0, np.pi, 0.0)
            heading[:, actor] = np.where(rows, snapped, heading[:, actor])
            across = across.finish(actor, rows & over)
        return replace(drive, across=across, heading=heading), points

    def _keep_aside(
        self, gap: story.Gap, rows: Bools, clock: Floats, table: Floats, every: Vehicles, points: Vehicles
    ) -> tuple[Vehicles, Bools]:
        # Vehicles that close a distance across the road, and whether they have it.
        actor = gap.actor
        before, now = (pick(vehicles, slice(actor, actor + 1)) for vehicles in (every, points))
        lag = speeds.place_gap(gap, self.bodies, table, self._see(gap, every)) - before.y[:, 0]
        slip = np.where(clock > 2.5 * self.dt, before.speed * np.sin(before.heading), 0.0)
        aside, over = speeds.close_aside(gap, table, lag, slip[:, 0], now.speed[:, 0], self.dt)
        angle = np.zeros_like(lag)
        if gap.acceleration is not None or gap.speed is not None:
            angle = np.arcsin(aside / np.maximum(np.abs(now.speed[:, 0]), np.abs(aside) + 1e-9))
        x = before.x[:, 0] + (now.x - before.x)[:, 0] * np.cos(angle)
        heading = now.heading[:, 0] + np.sign(np.cos(now.heading[:, 0])) * angle
        return put(points, actor, rows, x=x, y=before.y[:, 0] + aside * self.dt, heading=heading), over

    def _see(self, gap: story.Gap, every: Vehicles) -> Vehicles:
        # All vehicles, the one that a distance is to along the road of the one that keeps it.
        there = move_over(pick(every, gap.other), self.maps[gap.other], self.maps[gap.actor])
        found = np.isfinite(there.x)
        return put(every, gap.other, found, x=there.x, y=there.y, heading=there.heading)

    def _see_in_plane(self, k: int, every: Vehicles) -> Pose:
        line, station = self.maps[k].line, every.x[:, k]
        return *line.to_plane(station, every.y[:, k]), every.heading[:, k] + line.heading(station)

    def _path(self, number: int, table: Floats, drive: Drive) -> Path:
        action = self.story.actions[number]
        assert isinstance(action, story.Trajectory)
        anchors = drive.anchors[:, self.trajectories.index(number)]
        poses = {k: (anchors[:, k, 0], anchors[:, k, 1], anchors[:, k, 2]) for k in range(len(self.maps))}
        return build_path(action, self.maps[action.actor], self.maps, table, poses)

    def _references(self, place: story.Place | story.Trajectory, every: Vehicles) -> dict[int, Pose]:
        return {other: _pose(every, other) for other in list_places(place)}


def _pose(vehicles: Vehicles, k: int) -> Pose:
    return vehicles.x[:, k], vehicles.y[:, k], vehicles.heading[:, k]
