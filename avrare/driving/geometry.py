"""Rectangles in the plane, elementwise over arrays of any shape that broadcast together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
        along = np.array([0.5, 0.5, -0.5, -0.5]) * np.expand_dims(self.length, -1)
        across = np.array([0.5, -0.5, -0.5, 0.5]) * np.expand_dims(self.width, -1)
        cos, sin = np.expand_dims(np.cos(self.heading), -1), np.expand_dims(np.sin(self.heading), -1)
        return (
            np.expand_dims(self.x, -1) + cos * along - sin * across,
            np.expand_dims(self.y, -1) + sin * along + cos * across,
        )


def signed_distance(a: Rectangle, b: Rectangle) -> Floats:
    """Return the distance between two rectangles [m]; minus the depth of the overlap where they overlap."""
    outside_a, inside_a = _corner_distances(a, b)
    outside_b, inside_b = _corner_distances(b, a)
    separation = np.maximum(inside_a, inside_b)
    return np.where(separation > 0.0, np.minimum(outside_a, outside_b), separation)


def _corner_distances(a: Rectangle, b: Rectangle) -> tuple[Floats, Floats]:
    # The distance of b's nearest corner to ``a``, and the separation along the axes of ``a``.
    x, y = b.corners()
    dx, dy = x - np.expand_dims(a.x, -1), y - np.expand_dims(a.y, -1)
    cos, sin = np.expand_dims(np.cos(a.heading), -1), np.expand_dims(np.sin(a.heading), -1)
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    half_length, half_width = 0.5 * a.length, 0.5 * a.width
    beyond_x = np.maximum(np.abs(along) - np.expand_dims(half_length, -1), 0.0)
    beyond_y = np.maximum(np.abs(across) - np.expand_dims(half_width, -1), 0.0)
    nearest = np.sqrt(beyond_x**2 + beyond_y**2).min(axis=-1)
    gap_x = np.maximum(along.min(axis=-1) - half_length, -half_length - along.max(axis=-1))
    gap_y = np.maximum(across.min(axis=-1) - half_width, -half_width - across.max(axis=-1))
    return nearest, np.maximum(gap_x, gap_y)


def ego_rectangle(ego: Vehicles, scene: Scene) -> Rectangle:
    """Return the ego's rectangle with fields (N, 1), which broadcast against the others' (N, V)."""
    length, width = np.asarray(scene.ego_length), np.asarray(scene.ego_width)
    return Rectangle(ego.x[:, None], ego.y[:, None], ego.heading[:, None], length, width)


def other_rectangles(others: Vehicles, scene: Scene) -> Rectangle:
    """Return the others' rectangles, fields (N, V)."""
    return Rectangle(others.x, others.y, others.heading, scene.lengths, scene.widths)
