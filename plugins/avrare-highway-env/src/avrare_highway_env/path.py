"""A path of straight pieces through waypoints, and places relative to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.protocols import Floats

_ON = 1e4
"""After its last waypoint a path goes straight on for so long [m]."""


class Path:
    """Straight pieces from waypoint to waypoint, and straight on after the last.

    Args:
        waypoints: x and y of two or more points [m], each another than the one before.
    """

    def __init__(self, waypoints: Sequence[tuple[float, float]]) -> None:
        points = np.array(waypoints, dtype=np.float64)
        last = points[-1] - points[-2]
        self._points = np.concatenate([points, [points[-1] + _ON * last / np.hypot(*last)]])
        pieces = np.diff(self._points, axis=0)
        self._lengths = np.hypot(pieces[:, 0], pieces[:, 1])
        self._units = pieces / self._lengths[:, None]
        self._begins = np.concatenate([[0.0], np.cumsum(self._lengths)])

    def project(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """The point of the path that is nearest to each place.

        Args:
            x: Of any shape [m].
            y: Of the same shape [m].

        Returns:
            Its distance along the path from the first waypoint [m], its distance to the place [m], and the
            direction of the path there [rad].
        """
        dx, dy = x[..., None] - self._points[:-1, 0], y[..., None] - self._points[:-1, 1]
        ux, uy = self._units.T
        along = np.clip(dx * ux + dy * uy, 0.0, self._lengths)
        off = np.hypot(dx - along * ux, dy - along * uy)
        piece = off.argmin(axis=-1)
        chosen = piece[..., None]
        found = np.take_along_axis(along, chosen, axis=-1)[..., 0]
        nearest = np.take_along_axis(off, chosen, axis=-1)[..., 0]
        return self._begins[piece] + found, nearest, np.arctan2(uy, ux)[piece]

    def at(self, along: Floats) -> tuple[Floats, Floats]:
        """X and y of the point so far along the path [m]."""
        x, y = self._points.T
        return np.interp(along, self._begins, x), np.interp(along, self._begins, y)
