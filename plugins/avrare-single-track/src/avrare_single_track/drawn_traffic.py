"""Scripted vehicles whose starts and goals differ from particle to particle.

A plan is solved once for a few values of each number that is drawn, not for every particle: its samples are
smooth in its start and its goals, so those between are a polynomial of degree two through the solved ones,
of every number of a vehicle at once. Positions along a straight road are shifted, which is exact, and so are
those across it of a vehicle at constant velocity. In bends a vehicle at constant velocity advances from its
own start, and the start of a script cannot be drawn along them: where a bend begins would move with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Road, Vehicles
from avrare.protocols import Floats
from avrare_single_track.config import VehicleConfig


@dataclass(frozen=True)
class Mixture:
    """Place of N particles among the solved plans.

    Attributes:
        weights: (N, V, J) weight of each plan of each vehicle.
        x: (N, V) shift along the road [m].
        y: (N, V) shift across it [m].
    """

    weights: Floats
    x: Floats
    y: Floats


class DrawnTraffic:
    """Trajectories of V vehicles for drawn starts and goals.

    Args:
        vehicles: The vehicles with the medians of the drawn options.
        road: Lanes.
        dt: Step [s].
        laws: Law of each drawn option of a simulator, by its place: ``vehicles.0.speed``.
        plan: Makes the traffic of vehicles with fixed numbers: an object with ``at(step)``.

    Raises:
        UsageError: Too many numbers of one vehicle are drawn, or the start of a script along a road that
            bends, or a plan is not found.
    """

    def __init__(
        self, vehicles: tuple[VehicleConfig, ...], road: Road, dt: float, laws: Mapping[str, Any], plan: Any
    ) -> None:
        self.vehicles = vehicles
        self._dt, self._line = dt, road.line
        self._steady = np.array(
            [k for k, vehicle in enumerate(vehicles) if vehicle.drive is None], dtype=np.int64
        )
        self._starts = np.array([vehicles[k].x for k in self._steady], dtype=np.float64)
        self._axes: list[dict[str, Floats]] = []
        for index, vehicle in enumerate(vehicles):
            prefix = f"vehicles.{index}."
            drawn = {path.removeprefix(prefix): law for path, law in laws.items() if path.startswith(prefix)}
            if road.line is not None and vehicle.drive is not None and "x" in drawn:
                raise UsageError(
                    f"{vehicle.name!r}: its x is drawn, but it follows a script on a bent road",
                    "draw its speed or its goals, leave out its drive, or make the road straight",
                )
            planned = [name for name in drawn if not _is_shift(name, vehicle) and "driver." not in name]
            self._axes.append({name: np.unique(drawn[name].at((-3.0, 0.0, 3.0))) for name in planned})
            if len(planned) > 3:
                raise UsageError(
                    f"{vehicle.name!r}: {len(planned)} numbers of one script are drawn, and at most 3 can be",
                    f"its x may be drawn besides; these need a plan each: {', '.join(planned)}",
                )
        choices = [
            [dict(zip(axes, nodes, strict=True)) for nodes in product(*axes.values())] for axes in self._axes
        ]
        count = max(map(len, choices), default=1)
        self._plans = [
            plan(
                tuple(
                    with_numbers(vehicle, scripts[min(j, len(scripts) - 1)])
                    for vehicle, scripts in zip(vehicles, choices, strict=True)
                ),
                road,
                dt,
            )
            for j in range(count)
        ]

    def mix(self, values: Mapping[str, Floats], n: int) -> Mixture:
        """Return where the drawn values (N,) of N particles lie among the plans."""
        count = len(self.vehicles)
        weights = np.zeros((n, count, len(self._plans)))
        shifts = {axis: np.zeros((n, count)) for axis in ("x", "y")}
        for v, (vehicle, axes) in enumerate(zip(self.vehicles, self._axes, strict=True)):
            drawn = {name: values.get(f"vehicles.{v}.{name}") for name in (*axes, "x", "y")}
            for axis, shift in shifts.items():
                if (value := drawn[axis]) is not None and axis not in axes:
                    shift[:, v] = value - getattr(vehicle, axis)
            along = [_lagrange(nodes, np.asarray(drawn[name])) for name, nodes in axes.items()]
            for j, combination in enumerate(product(*(range(len(nodes)) for nodes in axes.values()))):
                weight = np.ones(n)
                for k, part in zip(combination, along, strict=True):
                    weight = weight * part[k]
                weights[:, v, j] = weight
        return Mixture(weights, shifts["x"], shifts["y"])

    def at(self, step: NDArray[np.int64], mixture: Mixture) -> Vehicles:
        """Return vehicles (N, V) at each particle's step."""
        total = [np.zeros(mixture.x.shape) for _ in range(5)]
        for j, plan in enumerate(self._plans):
            fields = vars(plan.at(step)).values()
            total = [
                part + mixture.weights[:, :, j] * field for part, field in zip(total, fields, strict=True)
            ]
        x, y, heading, speed, acceleration = total
        x, y = x + mixture.x, y + mixture.y
        if self._line is not None:
            steady = self._steady
            way = step[:, None] * self._dt * speed[:, steady]
            along, across = way * np.cos(heading[:, steady]), way * np.sin(heading[:, steady])
            starts = self._starts + mixture.x[:, steady]
            x[:, steady] = self._line.advance(starts, y[:, steady] - 0.5 * across, along)
        return Vehicles(x, y, heading, speed, acceleration)


def with_numbers(vehicle: VehicleConfig, numbers: Mapping[str, float]) -> VehicleConfig:
    """Return a vehicle with other numbers, such as ``speed`` or ``drive.v_goal``."""
    plain = {name: float(value) for name, value in numbers.items() if "." not in name}
    goals = {name.removeprefix("drive."): float(value) for name, value in numbers.items() if "." in name}
    if vehicle.drive is not None and goals:
        return vehicle.model_copy(update={**plain, "drive": vehicle.drive.model_copy(update=goals)})
    return vehicle.model_copy(update=plain)


def _is_shift(name: str, vehicle: VehicleConfig) -> bool:
    return name == "x" or (name == "y" and vehicle.drive is None)


def _lagrange(nodes: Floats, values: Floats) -> list[Floats]:
    weights = []
    for k, node in enumerate(nodes):
        weight = np.ones(len(values))
        for other in np.delete(nodes, k):
            weight = weight * (values - other) / (node - other)
        weights.append(weight)
    return weights
