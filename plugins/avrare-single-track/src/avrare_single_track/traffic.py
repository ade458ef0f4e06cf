"""The other vehicles: trajectories fixed before the run, the same for every particle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Road, Vehicles
from avrare.protocols import Floats
from avrare_single_track.config import VehicleConfig


class ScriptedTraffic:
    """Trajectories of V vehicles.

    Args:
        vehicles: What the scenario says of them.
        road: For the planner.
        dt: Step [s].
    """

    def __init__(self, vehicles: tuple[VehicleConfig, ...], road: Road, dt: float) -> None:
        self.dt = dt
        samples = [_samples(vehicle, road, dt) for vehicle in vehicles]
        self._last = np.array([len(x) - 1 for x, _, _, _ in samples], dtype=np.int64)
        longest = int(self._last.max(initial=0)) + 1
        self._table = np.zeros((4, longest, len(vehicles)))
        for v, series in enumerate(samples):
            for row, values in enumerate(series):
                self._table[row, : len(values), v] = values
                self._table[row, len(values) :, v] = values[-1]
        self._change = np.zeros_like(self._table[3])
        self._change[1:] = np.diff(self._table[3], axis=0) / dt

    def at(self, step: NDArray[np.int64]) -> Vehicles:
        """Vehicles (N, V) at each particle's step; at constant velocity beyond the end of a trajectory."""
        row = np.minimum(step[:, None], self._last)
        x, y, heading, speed = (self._table[k][row, np.arange(row.shape[1])] for k in range(4))
        beyond = (step[:, None] - row) * self.dt
        change = np.where(beyond > 0.0, 0.0, self._change[row, np.arange(row.shape[1])])
        return Vehicles(
            x + beyond * speed * np.cos(heading), y + beyond * speed * np.sin(heading), heading, speed, change
        )


def _samples(vehicle: VehicleConfig, road: Road, dt: float) -> tuple[Floats, Floats, Floats, Floats]:
    """x, y, heading and speed at every planned step."""
    if vehicle.drive is None:
        start = (vehicle.x, vehicle.y, vehicle.heading, vehicle.speed)
        x, y, heading, speed = (np.array([value]) for value in start)
        return x, y, heading, speed
    from avrare_mpc.trajectory import plan_trajectory

    planned = plan_trajectory(vehicle.drive, vehicle.x, vehicle.y, vehicle.speed, vehicle.heading, road, dt)
    return planned.x, planned.y, planned.heading, planned.speed
