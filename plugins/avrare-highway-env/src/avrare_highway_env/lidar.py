"""A ring of rays against rectangles, for all particles at once."""

from __future__ import annotations

import numpy as np

from avrare.driving.geometry import Rectangle
from avrare.protocols import Floats

_PARALLEL = 1e-12
"""Rays nearer to parallel to a side than this never cross it."""


def directions(cells: int) -> tuple[Floats, Floats]:
    """X and y of each ray, (cells,): ray k points 2 pi k / cells to the left of the x axis."""
    angle = 2.0 * np.pi * np.arange(cells) / cells
    return np.cos(angle), np.sin(angle)


def cast(
    x: Floats, y: Floats, objects: Rectangle, rays: tuple[Floats, Floats], reach: float
) -> tuple[Floats, np.ndarray]:
    """Distance to the nearest object along every ray, and which one that is.

    Objects count whose centres are within reach, as in highway-env's lidar.

    Args:
        x: (N,) where the rays begin [m].
        y: (N,) [m].
        objects: Fields (N, V); absent ones lie at infinity.
        rays: X and y of the rays' directions, (R,).
        reach: Of the rays [m].

    Returns:
        (N, R) distances, ``reach`` where nothing is hit, and (N, R) indices, -1 there.
    """
    dx, dy = objects.x - x[:, None], objects.y - y[:, None]
    near = np.isfinite(dx) & (dx**2 + dy**2 <= reach**2)
    dx, dy = np.where(near, dx, 0.0), np.where(near, dy, 0.0)
    cos, sin = np.cos(objects.heading), np.sin(objects.heading)
    distance = np.full((len(x), len(rays[0])), reach)
    hit = np.full(distance.shape, -1)
    for v in range(dx.shape[1]):
        rows = np.flatnonzero(near[:, v])
        if not rows.size:
            continue
        c, s, px, py = (field[rows, v, None] for field in (cos, sin, dx, dy))
        # everything in the object's own frame: where the ray begins, and where it points
        enter_a, leave_a = _slab(-(c * px + s * py), c * rays[0] + s * rays[1], 0.5 * objects.length[v])
        enter_b, leave_b = _slab(s * px - c * py, c * rays[1] - s * rays[0], 0.5 * objects.width[v])
        enter = np.maximum(enter_a, enter_b)
        leave = np.minimum(leave_a, leave_b)
        along = np.where((enter <= leave) & (leave >= 0.0), np.maximum(enter, 0.0), np.inf)
        nearer = along < distance[rows]
        distance[rows] = np.where(nearer, along, distance[rows])
        hit[rows] = np.where(nearer, v, hit[rows])
    return distance, hit


def _slab(begin: Floats, towards: Floats, half: float) -> tuple[Floats, Floats]:
    """Where rays enter and leave |coordinate| <= half."""
    safe = np.where(np.abs(towards) < _PARALLEL, _PARALLEL, towards)
    first, second = (-half - begin) / safe, (half - begin) / safe
    return np.minimum(first, second), np.maximum(first, second)


def closing(vx: Floats, vy: Floats, ego_vx: Floats, ego_vy: Floats, hit: np.ndarray,
            rays: tuple[Floats, Floats]) -> Floats:  # fmt: skip
    """(N, R) radial speed of what each ray hits relative to the ego, positive away [m/s]; 0 at misses."""
    if vx.shape[1] == 0:
        return np.zeros(hit.shape)
    index = np.maximum(hit, 0)
    dvx = np.take_along_axis(vx, index, axis=1) - ego_vx[:, None]
    dvy = np.take_along_axis(vy, index, axis=1) - ego_vy[:, None]
    return np.where(hit >= 0, dvx * rays[0] + dvy * rays[1], 0.0)
