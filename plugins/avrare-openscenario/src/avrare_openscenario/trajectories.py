"""Lines in the plane that vehicles follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from avrare.protocols import Floats
from avrare_openscenario.courses import Integers
from avrare_openscenario.story import Place, Trajectory

Pose = tuple[Floats, Floats, Floats]
_CORNER = 2.0
"""Most way before and after a corner of a polyline on which a body turns [m]."""


@dataclass(frozen=True)
class Path:
    """Polylines of N particles with M points each.

    Attributes:
        x: (N, M) [m].
        y: (N, M) [m].
        heading: (N, M) heading at the points; None: the direction of each segment [rad].
        corners: Whether a heading holds from its point to the next one, and bodies turn around the points.
    """

    x: Floats
    y: Floats
    heading: Floats | None
    corners: bool = False

    @classmethod
    def build(cls, curve: Trajectory, poses: list[Pose]) -> Path:
        """Return the points of a trajectory whose vertices have these poses (N,) in the plane."""
        x, y, heading = (np.stack([pose[axis] for pose in poses], axis=1) for axis in range(3))
        if curve.shape is not None:
            points = np.array(curve.shape)
            cos, sin = np.cos(heading), np.sin(heading)
            along, across = points[:, 0], points[:, 1]
            return cls(x + cos * along - sin * across, y + sin * along + cos * across, heading + points[:, 2])
        if curve.shares is not None:
            shares = np.array(curve.shares).T
            return cls(x @ shares, y @ shares, None)
        turned = all(vertex.turned for vertex in curve.vertices)
        return cls(x, y, heading if turned else None, corners=True)

    @cached_property
    def ways(self) -> Floats:
        """Way (N, M) from the first point to each [m]."""
        steps = np.hypot(np.diff(self.x, axis=1), np.diff(self.y, axis=1))
        return np.concatenate([np.zeros((len(steps), 1)), np.cumsum(steps, axis=1)], axis=1)

    def at(self, way: Floats) -> Pose:
        """Return the pose (N,) at a way (N,) along each, or straight on from its ends."""
        rows, begin, share = _locate(self.ways, way)
        beyond = way - np.clip(way, 0.0, self.ways[:, -1])
        x0, y0 = self.x[rows, begin], self.y[rows, begin]
        dx, dy = self.x[rows, begin + 1] - x0, self.y[rows, begin + 1] - y0
        if self.heading is None or self.corners:
            heading = self._turn(rows, begin, share)
        else:
            before, after = self.heading[rows, begin], self.heading[rows, begin + 1]
            heading = before + share * (after - before)
        straight = beyond / np.maximum(np.hypot(dx, dy), 1e-12)
        return x0 + (share + straight) * dx, y0 + (share + straight) * dy, heading

    @cached_property
    def _directions(self) -> Floats:
        # Heading (N, M - 1) on each segment.
        if self.heading is not None:
            return np.unwrap(self.heading[:, :-1], axis=1)
        return np.unwrap(np.arctan2(np.diff(self.y, axis=1), np.diff(self.x, axis=1)), axis=1)

    def _turn(self, rows: Integers, begin: Integers, share: Floats) -> Floats:
        # Heading on a segment, half-way to that of the next or last one where they meet.
        lengths, headings = np.diff(self.ways, axis=1), self._directions
        last = headings.shape[1] - 1
        here, length = headings[rows, begin], lengths[rows, begin]
        turned = np.array(here)
        for neighbour, left in ((begin - 1, share), (begin + 1, 1.0 - share)):
            other = np.clip(neighbour, 0, last)
            reach = np.minimum(_CORNER, 0.5 * np.minimum(length, lengths[rows, other]))
            near = np.clip(1.0 - left * length / np.maximum(reach, 1e-9), 0.0, 1.0)
            turned += 0.5 * near * (headings[rows, other] - here)
        return turned

    def when(self, times: Floats, time: Floats) -> tuple[Floats, Floats]:
        """Return the way (N,) and the speed at a time (N,), given those of all points or of the ends."""
        if times.shape[1] != self.ways.shape[1]:
            times = times[:, :1] + self.ways / self.ways[:, -1:] * np.diff(times, axis=1)
        rows, begin, share = _locate(times, time)
        way, step = self.ways[rows, begin], self.ways[rows, begin + 1] - self.ways[rows, begin]
        lasting = np.maximum(times[rows, begin + 1] - times[rows, begin], 1e-9)
        speed = np.where(time < times[:, 0], 0.0, step / lasting)
        return way + share * step + speed * np.maximum(time - times[:, -1], 0.0), speed

    def gear(self, way: Floats) -> Floats:
        """Return 1 (N,) where the heading at a way points along the line, -1 where against it."""
        rows, begin, _ = _locate(self.ways, way)
        direction = np.arctan2(np.diff(self.y, axis=1), np.diff(self.x, axis=1))[rows, begin]
        moves = np.diff(self.ways, axis=1)[rows, begin] > 0.0
        return np.where(moves & (np.cos(self.at(way)[2] - direction) < 0.0), -1.0, 1.0)

    def project(self, x: Floats, y: Floats) -> Floats:
        """Return the way (N,) of the points that are nearest to places (N,)."""
        x0, y0, x1, y1 = self.x[:, :-1], self.y[:, :-1], self.x[:, 1:], self.y[:, 1:]
        dx, dy = x1 - x0, y1 - y0
        squared = np.maximum(dx**2 + dy**2, 1e-12)
        share = np.clip(((x[:, None] - x0) * dx + (y[:, None] - y0) * dy) / squared, 0.0, 1.0)
        apart = np.hypot(x[:, None] - x0 - share * dx, y[:, None] - y0 - share * dy)
        rows, nearest = np.arange(len(x)), apart.argmin(axis=1)
        return np.asarray(self.ways[rows, nearest] + (share * np.sqrt(squared))[rows, nearest])


def _locate(table: Floats, value: Floats) -> tuple[Integers, Integers, Floats]:
    # Rows, index of the interval in each, and share of it.
    rows = np.arange(len(table))
    begin = np.clip((table <= value[:, None]).sum(axis=1) - 1, 0, table.shape[1] - 2)
    low, high = table[rows, begin], table[rows, begin + 1]
    share = np.clip((value - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    return rows, begin, share


def list_places(place: Place | Trajectory) -> list[int]:
    """Return the indices of the vehicles that a place or trajectory is relative to."""
    if isinstance(place, Trajectory):
        return [other for vertex in place.vertices for other in list_places(vertex)]
    others = [] if place.curve is None else list_places(place.curve)
    return others if place.other < 0 else [place.other, *others]
