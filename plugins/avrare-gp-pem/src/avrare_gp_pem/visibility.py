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
Rows = NDArray[np.intp]
_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
_MARGIN = 1e-9  # what rounding may take from an angle or a distance
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
    fraction = np.ones_like(seen.forward)
    particle, target = np.nonzero(_may_be_hidden(seen, half))  # rays are cast only where they may be stopped
    if len(target):
        fraction[particle, target] = _clear(seen, half, (particle, target), rays)
    return fraction


def category(fraction: Floats) -> Floats:
    """The visibility category of nuScenes: 1 (below 40 % in view), 2 (40-60), 3 (60-80), 4 (80-100)."""
    return np.asarray(1.0 + (fraction >= 0.4) + (fraction >= 0.6) + (fraction >= 0.8), np.float64)


def _may_be_hidden(seen: Relative, half: Floats) -> NDArray[np.bool_]:
    """(N, V) whether the circle around another vehicle reaches before the circle around this one."""
    radius, distance = np.hypot(*half.T), seen.range
    near = distance <= radius
    width = np.where(
        near, np.pi, np.arcsin(radius / np.maximum(distance, radius))
    )  # half the angle of a circle
    bearing = np.arctan2(seen.left, seen.forward)
    apart = np.abs(bearing[:, :, None] - bearing[:, None, :])
    apart = np.minimum(apart, 2 * np.pi - apart)
    shares = apart <= width[:, :, None] + width[:, None, :] + _MARGIN
    before = (distance - radius)[:, None, :] <= (distance + radius)[:, :, None] + _MARGIN
    vehicles = np.arange(len(half))
    shares[:, vehicles, vehicles] = False
    return np.asarray((shares & before).any(axis=-1))


def _clear(seen: Relative, half: Floats, pairs: tuple[Rows, Rows], rays: int) -> Floats:
    """(P,) share of the rays at a target that reach it, for P pairs of a particle and a target."""
    particle, target = pairs
    angles = _aimed(seen, half, pairs, rays)
    nearest = _distances(seen, half, particle, angles)  # (P, R, V)
    to_target = nearest[np.arange(len(target)), :, target]
    nearest[np.arange(len(target)), :, target] = np.inf
    clear = np.count_nonzero(nearest.min(axis=-1) >= to_target, axis=-1)
    return np.asarray(clear / rays, np.float64)


def _aimed(seen: Relative, half: Floats, pairs: tuple[Rows, Rows], rays: int) -> Floats:
    """(P, R) directions of the rays in the ego's frame [rad]."""
    forward, left, heading = seen.forward[pairs], seen.left[pairs], seen.heading[pairs]
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    along, across = (_CORNERS * half[pairs[1], None, :]).transpose(2, 0, 1)  # (P, 4) each
    x = forward[:, None] + cos * along - sin * across
    y = left[:, None] + sin * along + cos * across
    bearing = np.arctan2(left, forward)[:, None]
    offset = (np.arctan2(y, x) - bearing + np.pi) % (2 * np.pi) - np.pi  # no jump inside an interval
    low, high = offset.min(axis=-1, keepdims=True), offset.max(axis=-1, keepdims=True)
    midpoints = (np.arange(rays) + 0.5) / rays
    return np.asarray(bearing + low + (high - low) * midpoints)


def _distances(seen: Relative, half: Floats, particle: Rows, angles: Floats) -> Floats:
    """(P, R, V) distance along each ray to each vehicle of the particle, inf where it passes by."""
    forward, left, heading = seen.forward[particle], seen.left[particle], seen.heading[particle]
    turned = angles[..., None] - heading[:, None, :]
    cos, sin = np.cos(heading), np.sin(heading)
    origin = (-cos * forward - sin * left, sin * forward - cos * left)  # the ego's centre, for each vehicle
    enter, leave = np.zeros_like(turned), np.full_like(turned, np.inf)
    for axis, direction in enumerate((np.cos(turned), np.sin(turned))):
        safe = np.where(np.abs(direction) < _TINY, _TINY, direction)
        start = origin[axis][:, None, :]
        first, second = (-half[:, axis] - start) / safe, (half[:, axis] - start) / safe
        enter = np.maximum(enter, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    return np.where(enter <= leave, enter, np.inf)
