"""Vehicles that react: their memory, and their step from the tape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene, Vehicles
from avrare.protocols import Floats
from avrare_mpc.riccati.jit import announced
from avrare_single_track.config import VehicleConfig
from avrare_single_track.driver_model import PARAMETERS, advance

_PAUSE = 1.0
"""Time between two lane changes of a driver [s]."""
_LOOK = 0.5
"""Time between two comparisons of the lanes by a driver [s]; not at the same steps for all drivers."""


@dataclass(frozen=True)
class DriverMemory:
    """Memory of R drivers in N particles.

    Attributes:
        lane: (N, R) lane, or the one that is changed to.
        base: (N, R) y that is kept, or from which a change began [m].
        clock: (N, R) time since a change began, -1 where none is under way [s].
        pause: (N, R) time until the next change may begin [s].
        mood: (N, R) offset of the acceleration, an Ornstein-Uhlenbeck process [m/s^2].
        table: (N, R, 10) parameters where they are drawn, else None.
    """

    lane: NDArray[np.int64]
    base: Floats
    clock: Floats
    pause: Floats
    mood: Floats
    table: Floats | None = None


class ReactiveTraffic:
    """Drivers among the vehicles of a scene.

    Args:
        vehicles: All vehicles; those with a ``driver`` react.
        scene: Road and sizes.

    Attributes:
        places: (R,) index of each driver among the vehicles.
    """

    def __init__(self, vehicles: tuple[VehicleConfig, ...], scene: Scene) -> None:
        self.scene, self.dt = scene, scene.dt
        self.places = np.array(
            [k for k, one in enumerate(vehicles) if one.driver is not None], dtype=np.int64
        )
        drivers = [one.driver for one in vehicles if one.driver is not None]
        self.names = tuple(one.name for one in vehicles if one.driver is not None)
        self._index = np.full(len(vehicles) + 1, -1, dtype=np.int64)
        self._index[self.places] = np.arange(len(self.places))
        self._table = np.array([[getattr(one, name) for name in PARAMETERS] for one in drivers]).reshape(
            -1, 10
        )
        self._centres = np.array(scene.road.lane_centres)
        last = len(self._centres) - 1
        self._limits = np.array([one.lanes or (0, last) for one in drivers], dtype=np.int64).reshape(-1, 2)
        for row, one in enumerate(drivers):
            if not one.lane_changes:
                self._limits[row] = (1, 0)
        self._ends = np.array([np.inf if one.lane_end is None else one.lane_end for one in drivers])
        starts = [_nearest(np.array(vehicles[k].y), self._centres) for k in self.places.tolist()]
        self._forced = np.array(
            [
                (one.merge.lane, one.merge.from_step, start) if one.merge else (-1, 0, start)
                for one, start in zip(drivers, starts, strict=True)
            ],
            dtype=np.int64,
        ).reshape(-1, 3)
        self._brake = np.array(
            [
                (row, part.from_step, part.to_step, part.acceleration)
                for row, one in enumerate(drivers)
                for part in one.brake
            ]
        ).reshape(-1, 4)
        seconds = np.array([one.correlation_time for one in drivers])
        self._spread = np.array([one.acceleration_sd for one in drivers])
        self._decay = np.exp(-self.dt / seconds)
        self._lengths = np.append(scene.lengths, scene.ego_length)
        self._widths = np.append(scene.widths, scene.ego_width)

    def start(
        self, others: Vehicles, noise: Floats, values: Mapping[str, Floats] | None = None
    ) -> DriverMemory:
        """Return the memory at t = 0 from noise (N, R) and drawn parameters (N,) by their place."""
        y = others.y[:, self.places]
        n = len(y)
        table = None
        for path, value in (values or {}).items():
            steps = path.split(".")
            if steps[0] == "vehicles" and steps[2:3] == ["driver"]:
                table = np.tile(self._table, (n, 1, 1)) if table is None else table
                table[:, self._index[int(steps[1])], PARAMETERS.index(steps[3])] = value
        lane, idle = _nearest(y, self._centres), np.full(y.shape, -1.0)
        pause = np.tile(_LOOK * (np.arange(y.shape[1]) % 5) / 5.0, (n, 1))
        return DriverMemory(lane, y.copy(), idle, pause, self._spread * noise, table)

    def step(
        self, memory: DriverMemory, step: NDArray[np.int64], ego: Vehicles, others: Vehicles, noise: Floats
    ) -> tuple[DriverMemory, Floats]:
        """Return the memory and (5, N, R) x, y, heading, speed, acceleration of the drivers a step later."""
        with announced("note: the drivers of single_track are compiled, once for this machine and version"):
            lane = memory.lane.copy()
            base, clock, pause = memory.base.copy(), memory.clock.copy(), memory.pause.copy()
            x, y, v = (
                np.ascontiguousarray(np.column_stack([getattr(others, name), getattr(ego, name)]))
                for name in ("x", "y", "speed")
            )
            out = np.empty((5, *memory.mood.shape))
            advance(
                x, y, v, self._lengths, self._widths, self._index, self.places,
                self._table[None] if memory.table is None else memory.table, self._limits, self._ends,
                self._forced, self._brake, self._centres, float(self.scene.road.lane_width), self.dt, step,
                memory.mood, _PAUSE, _LOOK, lane, base, clock, pause, out,
            )  # fmt: skip
        line = self.scene.road.line
        if line is not None:  # the way driven, as a difference of stations
            before = others.x[:, self.places]
            aside = 0.5 * (others.y[:, self.places] + out[1])
            out[0] = line.advance(before, aside, out[0] - before)
        mood = self._decay * memory.mood + self._spread * np.sqrt(1.0 - self._decay**2) * noise
        return replace(memory, lane=lane, base=base, clock=clock, pause=pause, mood=mood), out

    def placed(self, others: Vehicles, found: Floats) -> Vehicles:
        """Return all vehicles with those of the drivers in their places."""
        fields = [np.array(part) for part in vars(others).values()]
        for field, part in zip(fields, found, strict=True):
            field[:, self.places] = part
        return Vehicles(*fields)


def _nearest(y: Floats, centres: Floats) -> Any:
    return np.abs(np.asarray(y)[..., None] - centres).argmin(axis=-1)
