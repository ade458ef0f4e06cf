"""Braking that would have avoided an impact: the ego keeps its path, the other vehicle its motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Vehicles
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.protocols import Bools, Floats

FULL_BRAKING = 6.0
"""Deceleration of an emergency braking [m/s^2]."""


@dataclass(frozen=True)
class Approach:
    """Approach of the ego to a vehicle until an impact, in the plane; fields of vehicles are (T,).

    Attributes:
        dt: Time between samples [s].
        ego: The ego, whose last sample is that of the impact.
        other: The other vehicle.
        sizes: Length and width of both [m].
    """

    dt: float
    ego: Vehicles
    other: Vehicles
    sizes: tuple[tuple[float, float], tuple[float, float]]

    def find_last_time(self) -> float | None:
        """Return the last time at which ``FULL_BRAKING`` avoids the impact [s]; None: there is none."""
        begin = np.arange(len(self.ego.x))
        avoiding = np.flatnonzero(self._avoids(begin, np.full(len(begin), FULL_BRAKING)))
        return float(avoiding[-1] * self.dt) if avoiding.size else None

    def find_least_deceleration(self) -> float:
        """Return the least constant deceleration from the first sample on that avoids it [m/s^2], or inf."""
        decelerations = np.linspace(0.1, 12.0, 120)  # up to those that a car can reach [m/s^2]
        avoiding = self._avoids(np.zeros(len(decelerations), dtype=np.int64), decelerations)
        return float(decelerations[np.argmax(avoiding)]) if avoiding.any() else float("inf")

    def _avoids(self, begin: NDArray[np.int64], deceleration: Floats) -> Bools:
        """Return (M,) whether braking from samples ``begin`` on avoids the impact."""
        samples = len(self.ego.x)
        # time after the impact for which the other continues, braking as it did at last [s]
        seconds_after = 8.0
        times = np.asarray(self.dt * np.arange(samples + round(seconds_after / self.dt)), dtype=np.float64)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(self.ego.x), np.diff(self.ego.y)))])
        speed = self.ego.speed[begin][:, None]
        braking = np.clip(times - self.dt * begin[:, None], 0.0, speed / deceleration[:, None])
        driven = np.interp(times, times[:samples], way)
        after = way[begin][:, None] + speed * braking - 0.5 * deceleration[:, None] * braking**2
        place = np.where(times <= self.dt * begin[:, None], driven, after)
        ego, other = self._at_way(place, way), self._at_time(times)
        boxes = (
            Rectangle(pose[0], pose[1], pose[2], np.asarray(size[0]), np.asarray(size[1]))
            for pose, size in zip((ego, other), self.sizes, strict=True)
        )
        return np.asarray((signed_distance(*boxes) > 0.0).all(axis=1))

    def _at_way(self, place: Floats, way: Floats) -> tuple[Floats, ...]:
        ego, heading = self.ego, np.unwrap(self.ego.heading)
        course = float(heading[-1])
        far = 1e3  # length of the straight that continues the ego's path [m]
        ends = far * np.cos(course), far * np.sin(course), 0.0
        path = np.append(way, way[-1] + far)
        series = zip((ego.x, ego.y, heading), ends, strict=True)
        return tuple(np.interp(place, path, np.append(values, values[-1] + end)) for values, end in series)

    def _at_time(self, times: Floats) -> tuple[Floats, ...]:
        other, samples = self.other, len(self.other.x)
        braking = max(-float(other.acceleration[-1]), 1e-9)
        later = np.clip(times - times[samples - 1], 0.0, other.speed[-1] / braking)
        beyond = other.speed[-1] * later - 0.5 * braking * later**2
        at = np.minimum(np.arange(len(times)), samples - 1)
        heading = other.heading[at]
        return other.x[at] + beyond * np.cos(heading), other.y[at] + beyond * np.sin(heading), heading
