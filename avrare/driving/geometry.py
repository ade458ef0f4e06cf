"""Rectangles in the plane, elementwise over arrays of any shape that broadcast together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np

from avrare.driving.frames import to_plane
from avrare.driving.values import Floats, Scene, Vehicles


@dataclass(frozen=True)
class Rectangle:
    """Oriented rectangles.

    Attributes:
        x: Centre [m].
        y: Centre [m].
        heading: Heading [rad].
        length: Length along the heading [m].
        width: Width across the heading [m].
    """

    x: Floats
    y: Floats
    heading: Floats
    length: Floats
    width: Floats

    def corners(self) -> tuple[Floats, Floats]:
        """Return x and y (..., 4) of the corners: front left, front right, rear right, rear left."""
        x, y = zip(*self.each_corner(), strict=True)
        return np.stack(x, axis=-1), np.stack(y, axis=-1)

    def each_corner(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield x and y of one corner after another, in the same order."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        for front, left in ((0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)):
            along, across = front * self.length, left * self.width
            yield self.x + cos * along - sin * across, self.y + sin * along + cos * across


def signed_distance(a: Rectangle, b: Rectangle) -> Floats:
    """Return the distance between two rectangles [m]; minus the depth of the overlap where they overlap."""
    outside_a, inside_a = _corner_distances(a, b)
    outside_b, inside_b = _corner_distances(b, a)
    separation = np.maximum(inside_a, inside_b)
    return np.where(separation > 0.0, np.minimum(outside_a, outside_b), separation)


def _corner_distances(a: Rectangle, b: Rectangle) -> tuple[Floats, Floats]:
    # The distance of b's nearest corner to ``a``, and the separation along the axes of ``a``. One corner
    # after another: NumPy is slow at reducing an axis of four.
    cos, sin = np.cos(a.heading), np.sin(a.heading)
    half_length, half_width = 0.5 * a.length, 0.5 * a.width
    along, across, squares = [], [], []
    for x, y in b.each_corner():
        dx, dy = x - a.x, y - a.y
        along.append(cos * dx + sin * dy)
        across.append(cos * dy - sin * dx)
        beyond_x = np.maximum(np.abs(along[-1]) - half_length, 0.0)
        beyond_y = np.maximum(np.abs(across[-1]) - half_width, 0.0)
        squares.append(beyond_x**2 + beyond_y**2)
    gap_x = np.maximum(reduce(np.minimum, along) - half_length, -half_length - reduce(np.maximum, along))
    gap_y = np.maximum(reduce(np.minimum, across) - half_width, -half_width - reduce(np.maximum, across))
    return np.sqrt(reduce(np.minimum, squares)), np.maximum(gap_x, gap_y)


def ego_rectangle(ego: Vehicles, scene: Scene) -> Rectangle:
    """Return the ego's rectangle in the plane, fields (N, 1), which broadcast against the others' (N, V)."""
    ego = to_plane(scene.road, ego)
    length, width = np.asarray(scene.ego_length), np.asarray(scene.ego_width)
    return Rectangle(ego.x[:, None], ego.y[:, None], ego.heading[:, None], length, width)


def other_rectangles(others: Vehicles, scene: Scene) -> Rectangle:
    """Return the others' rectangles in the plane, fields (N, V)."""
    others = to_plane(scene.road, others)
    return Rectangle(others.x, others.y, others.heading, scene.lengths, scene.widths)
