"""Vehicles that react: their memory, and their step from the tape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Road, Scene, Vehicles
from avrare.driving.lanes import ENDLESS, lane_ends
from avrare.protocols import Floats
from avrare_mpc.riccati.jit import announce
from avrare_single_track.config import MOST_REACTION, DriverConfig, VehicleConfig
from avrare_single_track.driver_model import PARAMETERS, advance

_PAUSE = 1.0
"""Time between two lane changes of a driver [s]."""
_LOOK = 0.5
"""Time between two comparisons of the lanes by a driver [s]; not at the same steps for all drivers."""
_REACTION = PARAMETERS.index("reaction_time")


@dataclass(frozen=True)
class DriverMemory:
    """Memory of R drivers in N particles.

    Attributes:
        lane: (N, R) lane, or the target of a lane change.
        base: (N, R) y that is kept, or from which a change began [m].
        clock: (N, R) time since a change began, -1 where none is under way [s].
        pause: (N, R) time until the next change may begin [s].
        mood: (N, R) offset of the acceleration, an Ornstein-Uhlenbeck process [m/s^2].
        haste: (N, Q) logarithm of the reaction time over its median, the same; of those whose time varies.
        past: (N, R, K) the model's demands at the last steps [m/s^2]; K = 0 where nobody is late.
        table: (N, R, 12) parameters where they are drawn, else None.
    """

    lane: NDArray[np.int64]
    base: Floats
    clock: Floats
    pause: Floats
    mood: Floats
    haste: Floats
    past: Floats
    table: Floats | None = None


class ReactiveTraffic:
    """Drivers among the vehicles of a scene.

    Args:
        vehicles: All vehicles; those with a ``driver`` react.
        scene: Road and sizes.
        substeps: Moves within a step of the scene, between which moods do not change.

    Attributes:
        places: (R,) index of each driver among the vehicles.
        noise_names: A number of each driver, and a second one of those whose reaction time varies.
    """

    def __init__(self, vehicles: tuple[VehicleConfig, ...], scene: Scene, substeps: int = 1) -> None:
        self.scene, self.dt = scene, scene.dt / substeps
        reacting = _list_reacting(vehicles)
        drivers = [driver for _, _, driver in reacting]
        self.places = np.array([k for k, _, _ in reacting], dtype=np.int64)
        self._order = {k: row for row, (k, _, _) in enumerate(reacting)}
        self._table = np.array(
            [[getattr(driver, name) for name in PARAMETERS] for driver in drivers]
        ).reshape(-1, len(PARAMETERS))
        self._varies = np.flatnonzero([driver.reaction_sd > 0.0 for driver in drivers])
        names = [vehicle.name for _, vehicle, _ in reacting]
        self.noise_names = tuple(
            [f"acceleration of {name}" for name in names]
            + [f"reaction time of {names[row]}" for row in self._varies]
        )
        seconds = np.array([driver.correlation_time for driver in drivers])
        self._decay = np.exp(-scene.dt / seconds)
        self._spread = np.array([driver.acceleration_sd for driver in drivers])
        self._haste_spread = np.array([driver.reaction_sd for driver in drivers])[self._varies]
        late = self._table[:, _REACTION].max(initial=0.0) * np.exp(4.0 * self._haste_spread.max(initial=0.0))
        self._slots = _slots(late, self.dt)
        ways = [1 if np.cos(vehicle.heading) >= 0.0 else -1 for _, vehicle, _ in reacting]
        self._flows = [
            Flow(vehicles, scene, np.flatnonzero(np.array(ways) == way), way, substeps)
            for way in (1, -1)
            if way in ways
        ]

    def start(
        self, others: Vehicles, noise: Floats, values: Mapping[str, Floats] | None = None
    ) -> DriverMemory:
        """Return the memory at t = 0 from noise (N, noise_size) and drawn parameters (N,) by their place."""
        y = others.y[:, self.places]
        n, drivers = y.shape
        table, slots = None, self._slots
        for path, value in (values or {}).items():
            steps = path.split(".")
            if steps[0] == "vehicles" and steps[2:3] == ["driver"]:
                table = np.tile(self._table, (n, 1, 1)) if table is None else table
                table[:, self._order[int(steps[1])], PARAMETERS.index(steps[3])] = value
                slots = _slots(MOST_REACTION, self.dt) if steps[3] == "reaction_time" else slots
        lane, idle = _nearest(y, np.array(self.scene.road.lane_centres)), np.full(y.shape, -1.0)
        pause = np.tile(_LOOK * (np.arange(drivers) % 5) / 5.0, (n, 1))
        mood, haste = self._spread * noise[:, :drivers], self._haste_spread * noise[:, drivers:]
        past = np.zeros((n, drivers, slots))
        return DriverMemory(lane, y.copy(), idle, pause, mood, haste, past, table)

    def step(
        self, memory: DriverMemory, step: NDArray[np.int64], ego: Vehicles, others: Vehicles, noise: Floats
    ) -> tuple[DriverMemory, Floats]:
        """Return the memory and (5, N, R) x, y, heading, speed, acceleration of the drivers a step later."""
        moved, out = self.move(memory, step, ego, others)
        return self.change_moods(moved, noise), out

    def move(
        self, memory: DriverMemory, substep: NDArray[np.int64], ego: Vehicles, others: Vehicles
    ) -> tuple[DriverMemory, Floats]:
        """Advance by a substep, with the moods as they are."""
        table = self._table[None] if memory.table is None else memory.table
        late = np.zeros_like(memory.mood)
        if memory.past.size:
            late += table[..., _REACTION] / self.dt
            late[:, self._varies] *= np.exp(memory.haste)
        later = replace(
            memory,
            **{name: getattr(memory, name).copy() for name in ("lane", "base", "clock", "pause", "past")},
        )
        out = np.empty((5, *memory.mood.shape))
        with announce("note: the drivers of single_track are compiled, once for this machine and version"):
            for flow in self._flows:
                flow.step(later, table, late, substep, ego, others, out)
        line = self.scene.road.line
        if line is not None:  # the way driven, as a difference of stations
            before = others.x[:, self.places]
            aside = 0.5 * (others.y[:, self.places] + out[1])
            out[0] = line.advance(before, aside, out[0] - before)
        return later, out

    def change_moods(self, memory: DriverMemory, noise: Floats) -> DriverMemory:
        """Return the memory with the moods of a step later."""
        drivers = len(self.places)
        mood = _walk(memory.mood, self._decay, self._spread, noise[:, :drivers])
        haste = _walk(memory.haste, self._decay[self._varies], self._haste_spread, noise[:, drivers:])
        return replace(memory, mood=mood, haste=haste)

    def place_drivers(self, others: Vehicles, states: Floats) -> Vehicles:
        """Return all vehicles with those of the drivers in their places."""
        fields = [np.array(part) for part in vars(others).values()]
        for field, part in zip(fields, states, strict=True):
            field[:, self.places] = part
        return Vehicles(*fields)


class Flow:
    """Drivers of one direction, seen along it: where they drive towards smaller x, the road turned around.

    Args:
        vehicles: All vehicles of the scene.
        scene: Road and sizes.
        rows: (R',) indices of these among the drivers.
        way: 1 towards greater x, -1 towards smaller x.
        substeps: Moves within a step of the scene.
    """

    def __init__(
        self,
        vehicles: tuple[VehicleConfig, ...],
        scene: Scene,
        rows: NDArray[np.int64],
        way: int,
        substeps: int,
    ) -> None:
        self._way, self._dt = way, scene.dt / substeps
        reacting = _list_reacting(vehicles)
        flow = [reacting[row] for row in rows]
        self._rows = None if way > 0 and len(rows) == len(reacting) else rows
        self._scripted = [k for k, vehicle in enumerate(vehicles) if vehicle.driver is None]
        self._signs = np.full(len(vehicles) + 1, float(way))  # of speeds: who comes towards them has -1
        self._signs[[k for k, vehicle, _ in reacting if np.cos(vehicle.heading) < 0.0]] = -way
        self._places = np.array([k for k, _, _ in flow], dtype=np.int64)
        self._index = np.full(len(vehicles) + 1, -1, dtype=np.int64)
        self._index[self._places] = np.arange(len(flow))
        road = scene.road
        self._last, self._width = len(road.lane_centres) - 1, float(road.lane_width)
        self._centres = np.ascontiguousarray(way * np.array(road.lane_centres)[::way])
        self._spans = _spans(road, way)
        starts = [int(_nearest(np.array(way * vehicle.y), self._centres)) for _, vehicle, _ in flow]
        limits = [
            (driver.lanes or _reach(road, way, self._lane(start))) if driver.lane_changes else (1, 0)
            for (_, _, driver), start in zip(flow, starts, strict=True)
        ]
        self._limits = np.array(
            [[self._lane(a), self._lane(b)][::way] if a <= b else [a, b] for a, b in limits], dtype=np.int64
        )
        ends = [driver.lane_end for _, _, driver in flow]
        self._ends = np.array([np.inf if end is None else way * end for end in ends])
        self._forced = np.array(
            [
                (self._lane(driver.merge.lane), driver.merge.from_step * substeps, start)
                if driver.merge
                else (-1, 0, start)
                for (_, _, driver), start in zip(flow, starts, strict=True)
            ],
            dtype=np.int64,
        )
        self._brake = np.array(
            [
                (row, phase.from_step * substeps, (phase.to_step + 1) * substeps - 1, phase.acceleration)
                for row, (_, _, driver) in enumerate(flow)
                for phase in driver.brake
            ]
        ).reshape(-1, 4)
        self._lengths = np.append(scene.lengths, scene.ego_length)
        self._widths = np.append(scene.widths, scene.ego_width)

    def _lane(self, lane: Any) -> Any:
        return lane if self._way > 0 else self._last - lane

    def _see(self, ego: Vehicles, others: Vehicles) -> list[Floats]:
        # x, y and speed (N, V + 1) along the road: those of drivers and, nearly, of the ego are along their
        # lanes. In place: arrays of this size are dear.
        x, y, v = (
            np.column_stack([getattr(others, name), getattr(ego, name)]) for name in ("x", "y", "speed")
        )
        if self._way < 0:
            x *= -1.0
            y *= -1.0
        v *= self._signs
        if self._scripted:
            v[:, self._scripted] *= np.cos(others.heading[:, self._scripted])
        return [x, y, v]

    def step(
        self,
        memory: DriverMemory,
        table: Floats,
        late: Floats,
        step: NDArray[np.int64],
        ego: Vehicles,
        others: Vehicles,
        out: Floats,
    ) -> None:
        """Write the next states into ``out`` (5, N, R) and into the fields of the memory."""
        fields: Any = [memory.mood, late, memory.lane, memory.base, memory.clock, memory.pause, memory.past]
        states = out
        if self._rows is not None:  # some of the drivers, or turned around
            fields = [np.ascontiguousarray(part[:, self._rows]) for part in fields]
            fields[2:4] = self._lane(fields[2]), self._way * fields[3]
            table, states = np.ascontiguousarray(table[:, self._rows]), np.empty((5, *fields[0].shape))
        (x, y, v), (mood, late, lane, base, clock, pause, past) = self._see(ego, others), fields
        advance(
            x, y, v, self._lengths, self._widths, self._index, self._places, table, self._limits, self._ends,
            self._forced, self._brake, self._centres, self._spans, self._width, self._dt, step, mood, late,
            _PAUSE, _LOOK, lane, base, clock, pause, past, states,
        )  # fmt: skip
        if self._rows is None:
            return
        memory.lane[:, self._rows], memory.base[:, self._rows] = self._lane(lane), self._way * base
        for target, part in ((memory.clock, clock), (memory.pause, pause), (memory.past, past)):
            target[:, self._rows] = part
        states[:2] *= self._way
        states[2] += 0.0 if self._way > 0 else np.pi
        out[:, :, self._rows] = states


def _list_reacting(vehicles: tuple[VehicleConfig, ...]) -> list[tuple[int, VehicleConfig, DriverConfig]]:
    return [(k, vehicle, vehicle.driver) for k, vehicle in enumerate(vehicles) if vehicle.driver is not None]


def _reach(road: Road, way: int, start: int) -> tuple[int, int]:
    # First and last lane of this direction that are side by side with the one at the start, or next to it.
    lanes = [lane for lane in range(len(road.lane_centres)) if (lane in road.opposing) == (way < 0)]
    groups = np.split(lanes, np.flatnonzero(np.diff(lanes) > 1) + 1) if lanes else [np.array([1, 0])]
    group = min(groups, key=lambda lane_group: float(np.abs(lane_group - start).min()))
    return int(group[0]), int(group[-1])


def _spans(road: Road, way: int) -> Floats:
    count = len(road.lane_centres)
    spans = np.array([[-np.inf] * count, [np.inf] * count])
    if road.lanes:
        begin, end = lane_ends(road)
        spans = np.where(np.abs([begin, end]) < ENDLESS, [begin, end], spans)
    return np.ascontiguousarray(spans if way > 0 else -spans[::-1, ::-1])


def _slots(late: float, dt: float) -> int:
    return int(np.ceil(min(late, MOST_REACTION) / dt)) + 2 if late > 0.0 else 0


def _walk(now: Floats, decay: Floats, spread: Floats, noise: Floats) -> Floats:
    return np.asarray(decay * now + spread * np.sqrt(1.0 - decay**2) * noise)


def _nearest(y: Floats, centres: Floats) -> Any:
    return np.abs(np.asarray(y)[..., None] - centres).argmin(axis=-1)
