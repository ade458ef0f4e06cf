"""Path of straight segments, followed by pure pursuit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats


class Path:
    """Path of straight segments between points, extended straight after the last.

    Args:
        points: x and y of two or more points [m]; consecutive points differ.
    """

    def __init__(self, points: Sequence[tuple[float, float]]) -> None:
        corners = np.array(points, dtype=np.float64)
        last = corners[-1] - corners[-2]
        # straight on for 10 km
        corners = np.concatenate([corners, [corners[-1] + 1e4 * last / np.hypot(*last)]])
        segments = np.diff(corners, axis=0)
        self._corners, self._lengths = corners, np.hypot(*segments.T)
        self._units = segments / self._lengths[:, None]
        self._stations = np.concatenate([[0.0], np.cumsum(self._lengths)])

    def project(self, x: Floats, y: Floats) -> Floats:
        """Return the distance (N,) along the path of the points nearest to positions (N,) [m]."""
        away = np.stack([x, y], axis=1)[:, None] - self._corners[:-1]
        along = np.clip((away * self._units).sum(axis=2), 0.0, self._lengths)
        off = np.hypot(*np.moveaxis(away - along[:, :, None] * self._units, 2, 0))
        nearest = off.argmin(axis=1)
        return np.asarray(self._stations[nearest] + np.take_along_axis(along, nearest[:, None], axis=1)[:, 0])

    def steer(self, ego: Vehicles, lookahead: float) -> Floats:
        """Return the yaw rate (N,) of the arc to a point ahead on the path (Coulter, 1992) [rad/s]."""
        ahead = self.project(ego.x, ego.y) + np.maximum(lookahead, 0.5 * ego.speed)
        dx, dy = (np.interp(ahead, self._stations, c) for c in self._corners.T)
        dx, dy = dx - ego.x, dy - ego.y
        across = np.cos(ego.heading) * dy - np.sin(ego.heading) * dx
        return np.asarray(2.0 * ego.speed * across / (dx**2 + dy**2))
