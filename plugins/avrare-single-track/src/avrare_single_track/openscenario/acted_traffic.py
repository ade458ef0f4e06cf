"""Traffic that acts out a storyboard, all particles at once; triggers see the ego as it drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_single_track.openscenario.conditions import Traffic, holds
from avrare_single_track.openscenario.scenario_file import ScenarioFile
from avrare_single_track.openscenario.starts import lane_middle, nearest_lane, place_all
from avrare_single_track.openscenario.story import FORMS, LaneChange, SpeedChange, Transition, Trigger

Integers = NDArray[np.int64]
_PEAKS = {"step": 0.0, "linear": 1.0, "cubic": 1.5, "sinusoidal": 0.5 * np.pi}
"""Highest rate of a transition over its mean rate."""
_AT_REST = 1e-3
"""Speed below which a vehicle stands still [m/s]."""
_CRAWL = 0.5
"""Speed below which a heading does not follow a lane change [m/s]."""


@dataclass(frozen=True)
class Course:
    """Transitions under way, of one quantity of V vehicles in N particles.

    Attributes:
        action: (N, V) index of the action, -1: none.
        start: (N, V) value at its begin.
        target: (N, V) value at its end.
        clock: (N, V) time or way since its begin [s or m].
        span: (N, V) time or way that it takes.
        form: (N, V) index of its shape.
        by_way: (N, V) whether it goes by the way driven.
    """

    action: Integers
    start: Floats
    target: Floats
    clock: Floats
    span: Floats
    form: Integers
    by_way: Bools

    @classmethod
    def idle(cls, n: int, vehicles: int) -> Course:
        """Return no transitions."""
        shape = (n, vehicles)
        start, target, clock, span = np.zeros((4, *shape))
        form, by_way = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
        return cls(np.full(shape, -1), start, target, clock, span, form, by_way)

    def begin(self, action: int, vehicle: int, rows: Bools, **values: Floats | int | bool) -> Course:
        """Return the courses with a new one of one vehicle in some rows."""
        fields = {name: np.array(part) for name, part in vars(self).items()}
        for name, value in {"action": action, "clock": 0.0, **values}.items():
            fields[name][:, vehicle] = np.where(rows, value, fields[name][:, vehicle])
        return Course(**fields)

    def stop(self, actions: Sequence[int], rows: Bools) -> Course:
        """Return the courses without some actions in some rows."""
        stopped = np.isin(self.action, list(actions)) & rows[:, None]
        return replace(self, action=np.where(stopped, -1, self.action))

    def advance(self, dt: float, way: Floats) -> tuple[Course, Floats, Floats]:
        """Return the courses a step later, the values there, and their change by second or metre."""
        clock = self.clock + np.where(self.by_way, way, dt)
        lasting = self.span > 0.0
        share = np.where(lasting, np.minimum(clock / np.where(lasting, self.span, 1.0), 1.0), 1.0)
        done, rate = _transition(self.form, share)
        value = np.where(share >= 1.0 - 1e-9, self.target, self.start + (self.target - self.start) * done)
        slope = np.where(lasting & (share < 1.0 - 1e-9), (self.target - self.start) * rate, 0.0)
        action = np.where(share >= 1.0 - 1e-9, -1, self.action)
        return replace(self, clock=clock, action=action), value, slope / np.where(lasting, self.span, 1.0)


@dataclass(frozen=True)
class StoryMemory:
    """State of a storyboard in N particles: C conditions, A acts, E events, V vehicles and the ego.

    Attributes:
        table: (N, K) numbers of the file.
        acts: (N, A) which acts have begun.
        begun: (N, E) step at which an event began, -1 before.
        ended: (N, E) step at which it ended, -1 before.
        before: (N, C) 1 where a condition held at the last step, 0 where not, -1 before the first.
        late: (N, C, D) what held, edges included, at the last D steps, the newest first.
        travelled: (N, V + 1) way so far [m].
        still: (N, V + 1) time at rest so far [s].
        heading: (N, V) heading of the bodies at the start, which they keep against their lanes [rad].
        speed: Changes of speed.
        across: Changes of offset.
    """

    table: Floats
    acts: Bools
    begun: Integers
    ended: Integers
    before: Integers
    late: Bools
    travelled: Floats
    still: Floats
    heading: Floats
    speed: Course
    across: Course


class ActedTraffic:
    """Vehicles of a file.

    Args:
        file: The file.
        dt: Step [s].
    """

    def __init__(self, file: ScenarioFile, dt: float) -> None:
        self.file, self.story, self.roads, self.dt = file, file.story, file.roads, dt
        self.lengths = np.array([body.length for body in file.bodies])
        self.widths = np.array([body.width for body in file.bodies])
        self.ahead = np.array([body.ahead for body in file.bodies])
        self.count = len(file.bodies) - file.ego
        self.delays = np.array([one.delay for one in self.story.conditions], dtype=np.int64)

    def start(self, n: int, values: Mapping[str, Floats]) -> tuple[Vehicles, Vehicles, StoryMemory]:
        """Return the ego (N,), the others (N, V) and the memory at t = 0, with drawn parameters (N,)."""
        table = self.file.parameters.table(values, n)
        s, d, heading = place_all(self.story, self.roads, table, self.ahead)
        speed = table[:, list(self.story.speeds)]
        every = Vehicles(s, d, heading, speed, np.zeros_like(speed))
        story, vehicles = self.story, self.count
        memory = StoryMemory(
            table,
            np.zeros((n, len(story.acts)), np.bool_),
            np.full((n, len(story.events)), -1),
            np.full((n, len(story.events)), -1),
            np.full((n, len(story.conditions)), -1),
            np.zeros((n, len(story.conditions), int(self.delays.max(initial=0)) + 1), np.bool_),
            np.zeros_like(speed),
            np.zeros_like(speed),
            heading[:, :vehicles],
            Course.idle(n, vehicles),
            Course.idle(n, vehicles),
        )
        ego, others = (
            Vehicles(*(part[:, rows] for part in vars(every).values())) for rows in (-1, slice(vehicles))
        )
        return ego, others, memory

    def check_start(self) -> None:
        """Raise an error where a vehicle starts off the road, or the ego against it.

        Raises:
            UsageError: Such a vehicle.
        """
        ego, others, _ = self.start(1, {})
        starts = [(others.x[0, k], others.heading[0, k]) for k in range(self.count)]
        starts += [(ego.x[0], ego.heading[0])] if self.file.ego else []
        length = self.roads.line.length
        for body, (station, heading) in zip(self.file.bodies, starts, strict=True):
            if not np.isfinite(station):
                raise UsageError(f"{self.file.path}: {body.name!r} is on no road at the start")
            if not 0.0 <= station <= length:
                text = f"{self.file.path}: {body.name!r} begins at {station:.6g} m of its road"
                raise UsageError(text, f"the road goes from 0 to {length:.6g} m")
            if self.file.ego and body is self.file.bodies[-1] and np.cos(heading) < 0.0:
                text = f"{self.file.path}: {body.name!r} drives against the reference line of its road"
                raise UsageError(text, "only an ego that drives along it is supported")

    def step(
        self, memory: StoryMemory, step: Integers, ego: Vehicles | None, others: Vehicles
    ) -> tuple[StoryMemory, Vehicles]:
        """Return the memory and the others one step later; the ego, if there is one, is that of this step."""
        memory = self._trigger(memory, step, _join(others, ego))
        memory, found = self._move(memory, others)
        mean = replace(found, speed=0.5 * (others.speed + found.speed))
        driven = _join(mean, ego).speed * self.dt
        resting = _join(found, ego).speed < _AT_REST
        memory = replace(
            memory,
            travelled=memory.travelled + driven,
            still=np.where(resting, memory.still + self.dt, 0.0),
        )
        return self._end_events(memory, step + 1), found

    def _trigger(self, memory: StoryMemory, step: Integers, every: Vehicles) -> StoryMemory:
        traffic = Traffic(
            np.asarray(step * self.dt, dtype=np.float64),
            every,
            self.lengths,
            self.widths,
            self.ahead,
            memory.travelled,
            memory.still,
        )
        memory, met = self._conditions(memory, traffic)
        acts = np.array(memory.acts)
        for index, trigger in enumerate(self.story.acts):
            acts[:, index] |= _meets(trigger, met)
        memory = replace(memory, acts=acts)
        for index, event in enumerate(self.story.events):
            rows = acts[:, event.act] & (memory.begun[:, index] < 0) & _meets(event.trigger, met)
            if rows.any():
                memory = self._begin_event(memory, index, rows, step, every)
        return memory

    def _conditions(self, memory: StoryMemory, traffic: Traffic) -> tuple[StoryMemory, Bools]:
        conditions = self.story.conditions
        if not conditions:
            return memory, np.zeros((len(memory.table), 0), np.bool_)
        raw = np.stack(
            [
                holds(one, traffic, self.roads, memory.table, memory.acts, memory.begun, memory.ended)
                for one in conditions
            ],
            axis=1,
        )
        edges = np.array(raw)
        for index, one in enumerate(conditions):
            was = memory.before[:, index]
            if one.edge in ("rising", "falling", "risingOrFalling"):
                rises, falls = raw[:, index] & (was == 0), ~raw[:, index] & (was == 1)
                edges[:, index] = {"rising": rises, "falling": falls}.get(one.edge, rises | falls)
        late = np.concatenate([edges[:, :, None], memory.late[:, :, :-1]], axis=2)
        met = late[:, np.arange(len(conditions)), self.delays]
        return replace(memory, before=raw.astype(np.int64), late=late), met

    def _begin_event(
        self, memory: StoryMemory, index: int, rows: Bools, step: Integers, every: Vehicles
    ) -> StoryMemory:
        event = self.story.events[index]
        ended, begun = np.array(memory.ended), np.array(memory.begun)
        begun[:, index] = np.where(rows, step, begun[:, index])
        if event.overrides:
            for other, one in enumerate(self.story.events):
                running = rows & (begun[:, other] >= 0) & (ended[:, other] < 0)
                if other != index and one.maneuver == event.maneuver and running.any():
                    ended[:, other] = np.where(running, step, ended[:, other])
                    memory = replace(
                        memory,
                        speed=memory.speed.stop(one.actions, running),
                        across=memory.across.stop(one.actions, running),
                    )
        memory = replace(memory, begun=begun, ended=ended)
        for number in event.actions:
            action = self.story.actions[number]
            if isinstance(action, SpeedChange):
                memory = replace(memory, speed=self._begin_speed(memory, number, action, rows, every))
            else:
                memory = replace(memory, across=self._begin_across(memory, number, action, rows, every))
        return memory

    def _begin_speed(
        self, memory: StoryMemory, number: int, action: SpeedChange, rows: Bools, every: Vehicles
    ) -> Course:
        now, target = every.speed[:, action.actor], memory.table[:, action.target]
        if action.other >= 0:
            theirs = every.speed[:, action.other]
            target = target * theirs if action.factor else target + theirs
        target, value = np.maximum(target, 0.0), memory.table[:, action.transition.value]
        if (
            action.transition.form != "step" and action.transition.dimension == "distance"
        ):  # as long as the way takes, at the mean of both speeds
            with np.errstate(divide="ignore", invalid="ignore"):
                span = 2.0 * value / (now + target)
        else:
            span = _span(action.transition, target - now, value)
        form = FORMS.index(action.transition.form)
        return memory.speed.begin(
            number, action.actor, rows, start=now, target=target, span=span, form=form, by_way=False
        )

    def _begin_across(
        self, memory: StoryMemory, number: int, action: LaneChange, rows: Bools, every: Vehicles
    ) -> Course:
        now, lane = every.y[:, action.actor], np.full(len(rows), action.lane)
        if action.other >= 0:
            along = np.sign(np.cos(every.heading[:, action.other])).astype(np.int64)
            lane = nearest_lane(self.roads, every.y[:, action.other]) + along * action.lane
        target = lane_middle(self.roads, lane) + memory.table[:, action.offset]
        span = _span(action.transition, target - now, memory.table[:, action.transition.value])
        return memory.across.begin(
            number,
            action.actor,
            rows,
            start=now,
            target=target,
            span=span,
            form=FORMS.index(action.transition.form),
            by_way=action.transition.dimension == "distance",
        )

    def _move(self, memory: StoryMemory, others: Vehicles) -> tuple[StoryMemory, Vehicles]:
        active = memory.speed.action >= 0
        course, wanted, _ = memory.speed.advance(self.dt, np.zeros_like(others.speed))
        speed = np.where(active, wanted, others.speed)
        begin = np.where(active & (memory.speed.span <= 0.0), speed, others.speed)  # a step has no way
        way = 0.5 * (begin + speed) * self.dt
        changing = memory.across.action >= 0
        across, aside, slope = memory.across.advance(self.dt, way)
        y = np.where(changing, aside, others.y)
        direction = np.where(np.cos(memory.heading) < 0.0, -1.0, 1.0)
        line = self.roads.road.line
        x = others.x + direction * way
        if line is not None:
            x = line.advance(others.x, 0.5 * (others.y + y), direction * way)
        drift = np.where(changing & (speed > _CRAWL), slope * np.where(memory.across.by_way, speed, 1.0), 0.0)
        heading = memory.heading + direction * np.arctan2(drift, np.maximum(speed, _CRAWL))
        found = Vehicles(x, y, heading, speed, (speed - others.speed) / self.dt)
        return replace(memory, speed=course, across=across), found

    def _end_events(self, memory: StoryMemory, step: Integers) -> StoryMemory:
        ended = np.array(memory.ended)
        for index, event in enumerate(self.story.events):
            busy = np.zeros(len(ended), np.bool_)
            for course in (memory.speed, memory.across):
                busy |= np.isin(course.action, list(event.actions)).any(axis=1)
            over = (memory.begun[:, index] >= 0) & (ended[:, index] < 0) & ~busy
            ended[:, index] = np.where(over, step, ended[:, index])
        return replace(memory, ended=ended)


def _join(others: Vehicles, ego: Vehicles | None) -> Vehicles:
    if ego is None:
        return others
    pairs = zip(vars(others).values(), vars(ego).values(), strict=True)
    return Vehicles(*(np.column_stack(pair) for pair in pairs))


def _span(transition: Transition, change: Floats, value: Floats) -> Floats:
    # Time or way that a transition takes.
    if transition.form == "step":
        return np.zeros_like(change)
    if transition.dimension == "rate":
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(change == 0.0, 0.0, _PEAKS[transition.form] * np.abs(change) / value)
    return value


def _transition(form: Integers, share: Floats) -> tuple[Floats, Floats]:
    # Part of the change that is done, and its derivative.
    angle = np.pi * share
    smooth = share * share * (3.0 - 2.0 * share), 6.0 * share * (1.0 - share)
    wave = 0.5 - 0.5 * np.cos(angle), 0.5 * np.pi * np.sin(angle)
    done = np.select([form == 1, form == 2, form == 3], [share, smooth[0], wave[0]], 1.0)
    return done, np.select([form == 1, form == 2, form == 3], [np.ones_like(share), smooth[1], wave[1]], 0.0)


def _meets(trigger: Trigger, met: Bools) -> Bools:
    # Rows in which one group of conditions holds as a whole; a trigger without any is met.
    if not trigger:
        return np.ones(len(met), np.bool_)
    return np.asarray(np.any([met[:, list(group)].all(axis=1) for group in trigger], axis=0))
