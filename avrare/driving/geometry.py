"""Rectangles in the plane, elementwise over arrays of any shape, and the first contact of moving ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from avrare.driving.values import Bools, Floats, Scene, Vehicles, to_plane


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


def interpolate(before: Vehicles, after: Vehicles, share: Floats | float) -> Vehicles:
    """Return vehicles at a share of the way between two samples; accelerations are those after it."""
    turn = np.remainder(after.heading - before.heading + np.pi, 2.0 * np.pi) - np.pi
    x, y, speed = (
        getattr(before, name) + share * (getattr(after, name) - getattr(before, name))
        for name in ("x", "y", "speed")
    )
    return Vehicles(x, y, before.heading + share * turn, speed, after.acceleration)


def find_contacts(
    scene: Scene, before: tuple[Vehicles, Vehicles], after: tuple[Vehicles, Vehicles]
) -> Floats:
    """Return (N, V) the share of the step at which the ego first touches each vehicle; inf: it does not.

    Args:
        scene: Road and sizes.
        before: Ego (N,) and others (N, V) at one sample.
        after: The same at the next sample.
    """
    pairs = [(_columns(ego, others.x.shape), others) for ego, others in (before, after)]
    motion, near = _bound_motion(scene, *pairs)
    shares = np.full(motion.shape, np.inf)
    rows = np.nonzero(near)
    if not rows[0].size:
        return shares
    (ego, others), (later_ego, later_others) = (
        (_select(egos, rows), _select(other, rows)) for egos, other in pairs
    )
    lengths, widths = scene.lengths[rows[1]], scene.widths[rows[1]]
    bound, contacts = np.maximum(motion[rows], 1e-9), np.full(len(rows[0]), np.inf)
    at, looking = np.zeros(len(bound)), np.ones(len(bound), dtype=bool)
    while looking.any():
        boxes = (
            _rectangle(scene, interpolate(ego, later_ego, at), scene.ego_length, scene.ego_width),
            _rectangle(scene, interpolate(others, later_others, at), lengths, widths),
        )
        distance = signed_distance(*boxes)
        touching = looking & (distance <= 0.0)
        contacts[touching] = at[touching]
        looking &= ~touching & (at < 1.0)
        # No point of one box comes nearer to the other than by the bound of their relative motion.
        # a contact that is shorter may be missed
        at = np.minimum(at + np.maximum(distance, 0.02) / bound, 1.0)
    shares[rows] = contacts
    return shares


def _bound_motion(
    scene: Scene, before: tuple[Vehicles, Vehicles], after: tuple[Vehicles, Vehicles]
) -> tuple[Floats, Bools]:
    """Return the closing distance (N, V) of a point of one box to the other, and whether they could touch."""
    (ego, others), (later_ego, later_others) = (
        (to_plane(scene.road, start), to_plane(scene.road, other)) for start, other in (before, after)
    )
    reaches = 0.5 * np.hypot(scene.ego_length, scene.ego_width), 0.5 * np.hypot(scene.lengths, scene.widths)
    distance = np.hypot(others.x - ego.x, others.y - ego.y) - reaches[0] - reaches[1]
    ways = (later_others.x - later_ego.x - others.x + ego.x, later_others.y - later_ego.y - others.y + ego.y)
    motion = np.hypot(*ways)
    for start, later, reach in ((ego, later_ego, reaches[0]), (others, later_others, reaches[1])):
        motion = motion + reach * np.abs(
            np.remainder(later.heading - start.heading + np.pi, 2.0 * np.pi) - np.pi
        )
    # a vehicle that is faster [m/s] has appeared or vanished
    near = (distance <= motion) & (motion <= 150.0 * scene.dt + reaches[0])
    return np.asarray(motion), np.asarray(near)


def _columns(ego: Vehicles, shape: tuple[int, ...]) -> Vehicles:
    return Vehicles(*(np.broadcast_to(values[:, None], shape) for values in vars(ego).values()))


def _select(vehicles: Vehicles, rows: tuple[NDArray[np.int64], ...]) -> Vehicles:
    return Vehicles(*(values[rows] for values in vars(vehicles).values()))


def _rectangle(scene: Scene, vehicles: Vehicles, length: Floats | float, width: Floats | float) -> Rectangle:
    flat = to_plane(scene.road, vehicles)
    return Rectangle(flat.x, flat.y, flat.heading, np.asarray(length), np.asarray(width))
