"""How much of each vehicle the ego can see past the others.

Rays start at the ego's centre and are aimed at the angular interval that a vehicle fills, so that a vehicle
in full view is 1 at any range. Plan view only: a sensor on the roof sees a little more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene, World
from avrare_gp_pem.relative import Relative, relative

Floats = NDArray[np.float64]
_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
_TINY = 1e-12  # stands for a direction component of zero, so that slabs need no special case


def visibility(world: World, scene: Scene, rays: int = 24) -> Floats:
    """Fraction of each other vehicle's rectangle that the ego sees from its centre.

    Args:
        world: N particles.
        scene: Sizes of the V other vehicles.
        rays: Rays per vehicle, at the midpoints of equal parts of its angular interval.

    Returns:
        (N, V) in [0, 1]; a vehicle that covers the ego's centre is fully seen.
    """
    seen = relative(world)
    if not scene.names:
        return np.ones_like(seen.forward)
    half = np.stack([scene.lengths, scene.widths], axis=-1) / 2  # (V, 2)
    angles = _aimed(seen, half, rays)
    nearest = _distances(seen, half, angles)  # (N, V, R, V)
    vehicles = np.arange(len(scene.names))
    to_target = nearest[:, vehicles, :, vehicles].transpose(1, 0, 2)  # advanced indices come first
    nearest[:, vehicles, :, vehicles] = np.inf
    clear = np.count_nonzero(nearest.min(axis=-1) >= to_target, axis=-1)
    return np.asarray(clear / rays, np.float64)


def category(fraction: Floats) -> Floats:
    """The visibility category of nuScenes: 1 (below 40 % in view), 2 (40-60), 3 (60-80), 4 (80-100)."""
    return np.asarray(1.0 + (fraction >= 0.4) + (fraction >= 0.6) + (fraction >= 0.8), np.float64)


def _aimed(seen: Relative, half: Floats, rays: int) -> Floats:
    """(N, V, R) directions of the rays in the ego's frame [rad]."""
    cos, sin = np.cos(seen.heading)[..., None], np.sin(seen.heading)[..., None]
    along, across = (_CORNERS * half[:, None, :]).transpose(2, 0, 1)  # (V, 4) each
    x = seen.forward[..., None] + cos * along - sin * across
    y = seen.left[..., None] + sin * along + cos * across
    bearing = np.arctan2(seen.left, seen.forward)[..., None]
    offset = (np.arctan2(y, x) - bearing + np.pi) % (2 * np.pi) - np.pi  # no jump inside an interval
    low, high = offset.min(axis=-1, keepdims=True), offset.max(axis=-1, keepdims=True)
    midpoints = (np.arange(rays) + 0.5) / rays
    return bearing + low + (high - low) * midpoints  # type: ignore[no-any-return]


def _distances(seen: Relative, half: Floats, angles: Floats) -> Floats:
    """(N, V, R, V) distance along each ray to each vehicle, inf where it passes by."""
    turned = angles[..., None] - seen.heading[:, None, None, :]
    heading_cos, heading_sin = np.cos(seen.heading), np.sin(seen.heading)
    origin = (  # the ego's centre in the frame of each vehicle, (N, V)
        -heading_cos * seen.forward - heading_sin * seen.left,
        heading_sin * seen.forward - heading_cos * seen.left,
    )
    enter, leave = np.zeros_like(turned), np.full_like(turned, np.inf)
    for axis, direction in enumerate((np.cos(turned), np.sin(turned))):
        safe = np.where(np.abs(direction) < _TINY, _TINY, direction)
        start = origin[axis][:, None, None, :]
        first, second = (-half[:, axis] - start) / safe, (half[:, axis] - start) / safe
        enter = np.maximum(enter, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    return np.where(enter <= leave, enter, np.inf)
