"""Traffic that acts out a storyboard, all particles at once; triggers see the ego as it drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_openscenario.conditions import StoryMemory, Traffic, holds
from avrare_openscenario.courses import Course, Integers, put
from avrare_openscenario.motions import GONE, Drive, Motions
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import ScenarioFile
from avrare_openscenario.starts import move_all, move_along_body, move_over, pick, place_all, speed_all
from avrare_openscenario.story import EDGES, Assignment, Route, Trigger
from avrare_openscenario.ways import Ways

_AT_REST = 1e-3
"""Speed below which a vehicle stands still [m/s]."""


class ActedTraffic:
    """Vehicles of a file."""

    def __init__(self, file: ScenarioFile, dt: float) -> None:
        self.file, self.story, self.dt = file, file.story, dt
        self.maps: Sequence[RoadMap] = file.maps
        self.ways: Ways | None = None
        self.ahead = np.array([body.ahead for body in file.bodies])
        self.count = len(file.bodies) - file.ego
        self.motions = Motions(file, dt)
        self.delays = np.array([condition.delay for condition in self.story.conditions], dtype=np.int64)
        self.edges = np.array([EDGES.index(condition.edge) for condition in self.story.conditions], np.int64)
        # What each condition starts or stops: an act, the stop of an act, or an event, in one row of them.
        events = [event.trigger if event.whole < 0 else () for event in self.story.events]
        self.owners = np.zeros(len(self.story.conditions), np.int64)
        for index, trigger in enumerate((*self.story.acts, *self.story.stops, *events)):
            self.owners[[number for group in trigger or () for number in group]] = index
        self.acts = np.array([event.act for event in self.story.events], np.int64)
        counts = [event.count if event.whole < 0 else 0 for event in self.story.events]
        self.counts = np.array(counts, np.int64)

    def start(self, n: int, values: Mapping[str, Floats]) -> tuple[Vehicles, StoryMemory]:
        """Return the ego (N,) and the memory at t = 0, with drawn parameters (N,)."""
        table = self.file.parameters.table(values, n)
        if not self.file.ego and n == 1:
            self.ways = self.motions.ways = Ways(self.file)
            self.maps = self.motions.maps = self.ways.maps
        speed = speed_all(self.story, table)
        points = Vehicles(*place_all(self.story, self.maps, table), speed, np.zeros_like(speed))
        for action in self.story.adjustments:
            points = self.motions.put(action, table, points)
        story, vehicles = self.story, self.count
        if self.file.reverses:
            points.speed[:, -1] *= -1.0
            points.heading[:, -1] = points.heading[:, -1] % (2.0 * np.pi) - np.pi  # half a turn
        if self.ways is not None:
            self.ways.changed.update(range(len(self.maps)))
            points, _ = self.ways.renew(points, Course.idle(1, vehicles), [False] * len(self.maps))
        heading, speed = points.heading, points.speed
        every = move_all(self.maps, points, self.ahead)
        acts, conditions, events = len(story.acts), len(story.conditions), len(story.events)
        memory = StoryMemory(
            table,
            np.zeros((n, acts), np.bool_),
            np.zeros((n, acts), np.bool_),
            np.full((n, events), -1),
            np.full((n, events), -1),
            np.zeros((n, events), np.int64),
            np.zeros((n, len(story.groups)), np.int64),
            np.full((n, conditions), -1),
            np.zeros((n, conditions, int(self.delays.max(initial=0)) + 1), np.bool_),
            np.zeros_like(speed),
            np.zeros_like(speed),
            table[:, list(story.variables)],
            Drive(
                heading[:, :vehicles],
                Course.idle(n, vehicles),
                Course.idle(n, vehicles),
                np.zeros((n, vehicles), np.bool_),
                np.zeros((n, len(self.motions.trajectories), len(story.places), 3)),
            ),
            pick(points, slice(vehicles)),
            pick(every, slice(vehicles)),
        )
        return pick(every, -1), memory

    def show(self, memory: StoryMemory) -> Vehicles:
        """Return the middles (N, V) along the road of the ego, far away where that has no place for them."""
        every = memory.bodies
        for k, roads in enumerate(self.maps[: self.count]):
            body = pick(memory.bodies, k)
            seen = move_over(body, roads, self.maps[-1])
            lost = np.isnan(seen.x) & np.isfinite(body.x)
            away = {name: np.where(lost, 0.0, values) for name, values in vars(seen).items()}
            every = put(every, k, True, **{**away, "x": np.where(lost, GONE, seen.x)})
        return every

    def check_start(self) -> None:
        """Raise an error where a vehicle starts off the road of the ego, or the ego against it.

        Raises:
            UsageError: Such a vehicle.
        """
        ego, memory = self.start(1, {})
        starts = [(memory.bodies.x[0, k], memory.bodies.heading[0, k]) for k in range(self.count)]
        starts += [(ego.x[0], ego.heading[0])] if self.file.ego else []
        for body, roads, (station, heading) in zip(self.file.bodies, self.maps, starts, strict=True):
            length = roads.line.length
            if not np.isfinite(station):
                raise UsageError(f"{self.file.path}: {body.name!r} is on no road at the start")
            if self.file.ego and not 0.0 <= station <= length:
                text = f"{self.file.path}: {body.name!r} begins at {station:.6g} m of its road"
                raise UsageError(text, f"the road goes from 0 to {length:.6g} m")
            if self.file.ego and body is self.file.bodies[-1] and np.cos(heading) < 0.0:
                text = f"{self.file.path}: {body.name!r} drives against the reference line of its road"
                raise UsageError(text, "only an ego that drives along it is supported")

    def step(self, memory: StoryMemory, step: Integers, ego: Vehicles | None) -> StoryMemory:
        """Return the memory one step later; the ego, if there is one, is that of this step."""
        every, others = memory.points, memory.bodies
        if ego is not None:
            pose = move_along_body(self.maps[-1], ego.x, ego.y, ego.heading, -self.ahead[-1])
            every = _join(every, Vehicles(*pose, ego.speed, ego.acceleration))
        memory, every = self._trigger(memory, step, every, _join(others, ego))
        changes = memory.drive.across.action[:1].ravel()
        if self.ways is not None:
            follows = np.isin(changes, self.motions.trajectories).tolist()
            before = every.heading
            every, across = self.ways.renew(every, memory.drive.across, follows)
            turned = memory.drive.heading + every.heading - before
            landed = [k for k in self.ways.landed if self.maps[k].lanes]
            turned[:, landed] = np.where(np.cos(every.heading[:, landed]) < 0.0, np.pi, 0.0)
            memory = replace(memory, drive=replace(memory.drive, across=across, heading=turned))
        drive, points = self.motions.move(memory.table, memory.drive, step, every)
        if self.ways is not None:
            points = self.ways.stop(every, points, follows)
            self.ways.changed.update(np.flatnonzero((changes >= 0) & (drive.across.action[0] < 0)).tolist())
        bodies = move_all(self.maps, points, self.ahead)
        memory = replace(memory, drive=drive, points=points, bodies=bodies)
        mean = replace(bodies, speed=0.5 * np.abs(others.speed + bodies.speed))
        driven = _join(mean, ego).speed * self.dt
        resting = np.abs(_join(bodies, ego).speed) < _AT_REST
        memory = replace(
            memory, travelled=memory.travelled + driven, still=np.where(resting, memory.still + self.dt, 0.0)
        )
        return self._end_events(memory, step + 1)

    def _trigger(
        self, memory: StoryMemory, step: Integers, every: Vehicles, middles: Vehicles
    ) -> tuple[StoryMemory, Vehicles]:
        held = self._listen(memory, np.asarray(step * self.dt, dtype=np.float64), middles)
        _, met = self._meet(memory, held)
        acts, stopped = np.array(memory.acts), np.array(memory.stopped)
        for index, trigger in enumerate(self.story.acts):
            acts[:, index] |= _meets(trigger, met)
            if (stop := self.story.stops[index]) is not None:
                stopped[:, index] |= acts[:, index] & _meets(stop, met)
        memory = self._stop_events(replace(memory, acts=acts, stopped=stopped), step)
        memory, met = self._meet(memory, held)
        for index, event in enumerate(self.story.events):
            if event.whole >= 0:
                continue
            rows = acts[:, event.act] & ~stopped[:, event.act] & _meets(event.trigger, met)
            rows &= self._wait(memory)[:, index]
            if event.waits:
                peers = [k for k, peer in enumerate(self.story.events) if peer.maneuver == event.maneuver]
                rows &= ~((memory.begun[:, peers] >= 0) & (memory.ended[:, peers] < 0)).any(axis=1)
            if rows.any():
                memory, every = self._begin_event(memory, index, rows, step, every)
        return memory, every

    def _stop_events(self, memory: StoryMemory, step: Integers) -> StoryMemory:
        # The events of acts that their stop triggers ended.
        for index, event in enumerate(self.story.events):
            memory = self._end_event(memory, index, memory.stopped[:, event.act], step)
        return memory

    def _end_event(self, memory: StoryMemory, index: int, rows: Bools, step: Integers) -> StoryMemory:
        # An event that is running in some rows, and its actions, come to their end.
        rows = rows & (memory.begun[:, index] >= 0) & (memory.ended[:, index] < 0)
        if not rows.any():
            return memory
        ended, drive, actions = np.array(memory.ended), memory.drive, self.story.events[index].actions
        ended[:, index] = np.where(rows, step, ended[:, index])
        speed, across = (course.stop(actions, rows) for course in (drive.speed, drive.across))
        return replace(memory, ended=ended, drive=replace(drive, speed=speed, across=across))

    def _listen(self, memory: StoryMemory, time: Floats, middles: Vehicles) -> Bools:
        # (N, C) which conditions hold, edges and delays aside.
        complete = (memory.ended >= 0) & ~self._wait(memory) | memory.stopped[:, self.acts]
        traffic = Traffic(time, middles, self.file.bodies, self.maps, memory, complete)
        held = [holds(condition, traffic) for condition in self.story.conditions]
        return np.stack(held, axis=1) if held else np.zeros((len(memory.table), 0), np.bool_)

    def _meet(self, memory: StoryMemory, held: Bools) -> tuple[StoryMemory, Bools]:
        # (N, C) which conditions are met. One is looked at while what it starts, or stops, waits for it.
        running = memory.acts & ~memory.stopped
        waiting = self._wait(memory) & running[:, self.acts]
        awake = np.concatenate([~memory.acts, running, waiting], axis=1)[:, self.owners]
        rises, falls = held & (memory.before == 0), ~held & (memory.before == 1)
        edges = np.select([self.edges == k for k in range(3)], [held, rises, falls], rises | falls)
        late = np.concatenate([edges[:, :, None], memory.late[:, :, :-1]], axis=2) & awake[:, :, None]
        met = late[:, np.arange(len(self.delays)), self.delays]
        return replace(memory, before=np.where(awake, held, -1), late=late), met

    def _wait(self, memory: StoryMemory) -> Bools:
        # (N, E) which events may begin.
        return ((memory.begun < 0) | (memory.ended >= 0)) & (memory.runs < self.counts)

    def _begin_event(
        self, memory: StoryMemory, index: int, rows: Bools, step: Integers, every: Vehicles
    ) -> tuple[StoryMemory, Vehicles]:
        event = self.story.events[index]
        for other, peer in enumerate(self.story.events):
            if event.overrides and other != index and peer.maneuver == event.maneuver:
                memory = self._end_event(memory, other, rows, step)
        ended, begun = np.array(memory.ended), np.array(memory.begun)
        begins = [k for k, other in enumerate(self.story.events) if k == index or other.whole == index]
        begun[:, begins] = np.where(rows, step, begun[:, begins].T).T
        ended[:, begins] = np.where(rows, -1, ended[:, begins].T).T
        runs = np.array(memory.runs)
        runs[:, index] += rows
        memory = replace(memory, begun=begun, ended=ended, runs=runs)
        for number in event.actions:
            action = self.story.actions[number]
            if isinstance(action, Route):
                if self.ways is not None and rows.any():
                    self.ways.assign(action.actor, action.roads)
                continue
            if isinstance(action, Assignment):
                variables = np.array(memory.variables)
                value = _assign(action, memory, np.asarray(step * self.dt, np.float64))
                variables[:, action.name] = np.where(rows, value, variables[:, action.name])
                memory = replace(memory, variables=variables)
                continue
            drive, every = self.motions.begin(number, rows, memory.table, memory.drive, every)
            memory = replace(memory, drive=drive)
        return memory, every

    def _end_events(self, memory: StoryMemory, step: Integers) -> StoryMemory:
        ended = np.array(memory.ended)
        for index, event in enumerate(self.story.events):
            busy = np.zeros(len(ended), np.bool_)
            for course in (memory.drive.speed, memory.drive.across):
                busy |= np.isin(course.action, list(event.actions)).any(axis=1)
            over = (memory.begun[:, index] >= 0) & (ended[:, index] < 0) & ~busy
            ended[:, index] = np.where(over, step, ended[:, index])
        return self._repeat_groups(replace(memory, ended=ended))

    def _repeat_groups(self, memory: StoryMemory) -> StoryMemory:
        for index, group in enumerate(self.story.groups):
            events = list(group.events)
            counts = np.array([self.story.events[k].count for k in events])
            over = ((memory.runs[:, events] >= counts) & (memory.ended[:, events] >= 0)).all(axis=1)
            over &= memory.rounds[:, index] < group.count - 1
            if over.any():
                again = over[:, None] & np.isin(np.arange(len(self.story.events)), events)
                begun, ended = (np.where(again, -1, steps) for steps in (memory.begun, memory.ended))
                rounds, runs = np.array(memory.rounds), np.where(again, 0, memory.runs)
                rounds[over, index] += 1
                memory = replace(memory, begun=begun, ended=ended, runs=runs, rounds=rounds)
        return memory


def _assign(action: Assignment, memory: StoryMemory, time: Floats) -> Floats:
    value, now = memory.table[:, action.value], memory.variables[:, action.name]
    results = {"set": value, "add": now + value, "multiply": now * value, "start": value - time}
    return results[action.operation]


def _join(others: Vehicles, ego: Vehicles | None) -> Vehicles:
    if ego is None:
        return others
    pairs = zip(vars(others).values(), vars(ego).values(), strict=True)
    return Vehicles(*(np.column_stack(pair) for pair in pairs))


def _meets(trigger: Trigger, met: Bools) -> Bools:
    # Rows in which one group of conditions holds as a whole; a trigger without any is met.
    if not trigger:
        return np.ones(len(met), np.bool_)
    return np.asarray(np.any([met[:, list(group)].all(axis=1) for group in trigger], axis=0))
