"""Other vehicles as the ego sees them: relative poses, and how much of each is in view.

Rays start at the ego's centre and are aimed at the angular interval that a vehicle fills, so that a vehicle
in full view is 1 at any range. Plan view only: a sensor on the roof sees a little more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene, World
from avrare.driving.values import world_in_plane
from avrare.protocols import Bools, Floats

Indices = NDArray[np.intp]
_CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class Relative:
    """Poses of the other vehicles in the ego's frame: the ego's centre and heading are zero.

    Attributes:
        forward: (N, V) distance ahead [m].
        left: (N, V) distance to the left [m].
        heading: (N, V) heading minus the ego's [rad], not wrapped.
    """

    forward: Floats
    left: Floats
    heading: Floats

    @property
    def range(self) -> Floats:
        """(N, V) distance between centres [m]."""
        return np.sqrt(self.forward * self.forward + self.left * self.left)


def relative(world: World) -> Relative:
    """Return the other vehicles of ``world``, which is in the plane, in the ego's frame."""
    heading = world.ego.heading[:, None]
    dx = world.others.x - world.ego.x[:, None]
    dy = world.others.y - world.ego.y[:, None]
    cos, sin = np.cos(heading), np.sin(heading)
    return Relative(cos * dx + sin * dy, cos * dy - sin * dx, world.others.heading - heading)


def visibility(world: World, scene: Scene, rays: int = 24) -> Floats:
    """Return the fraction of each other vehicle's rectangle that the ego sees from its centre.

    Args:
        world: N particles.
        scene: Sizes of the V other vehicles.
        rays: Rays per vehicle, at the midpoints of equal parts of its angular interval.

    Returns:
        (N, V) in [0, 1]; a vehicle that covers the ego's centre is fully seen.
    """
    seen = relative(world_in_plane(scene.road, world))
    if not scene.names:
        return np.ones_like(seen.forward)
    half = np.stack([scene.lengths, scene.widths], axis=-1) / 2  # (V, 2)
    fraction = np.ones_like(seen.forward)
    particle, target = np.nonzero(_may_be_hidden(seen, half))  # cast rays only where one may be blocked
    if len(target):
        fraction[particle, target] = _visible_share(seen, half, (particle, target), rays)
    return fraction


def category(fraction: Floats) -> Floats:
    """Return nuScenes' visibility category: 1 (below 40 % in view), 2 (40-60), 3 (60-80), 4 (80-100)."""
    return np.asarray(1.0 + (fraction >= 0.4) + (fraction >= 0.6) + (fraction >= 0.8), np.float64)


def _may_be_hidden(seen: Relative, half: Floats) -> Bools:
    """Return a mask (N, V): whether another vehicle's circumscribed circle reaches in front of this one's."""
    radius, distance = np.hypot(*half.T), seen.range
    covers_ego = distance <= radius
    half_angle = np.where(covers_ego, np.pi, np.arcsin(radius / np.maximum(distance, radius)))
    bearing = np.arctan2(seen.left, seen.forward)
    angle = np.abs(bearing[:, :, None] - bearing[:, None, :])
    angle = np.minimum(angle, 2 * np.pi - angle)
    margin = 1e-9  # rounding error of an angle or a distance
    overlaps = angle <= half_angle[:, :, None] + half_angle[:, None, :] + margin
    in_front = (distance - radius)[:, None, :] <= (distance + radius)[:, :, None] + margin
    vehicles = np.arange(len(half))
    overlaps[:, vehicles, vehicles] = False
    return np.asarray((overlaps & in_front).any(axis=-1))


def _visible_share(seen: Relative, half: Floats, pairs: tuple[Indices, Indices], rays: int) -> Floats:
    """Return (P,) the share of rays that reach their target, for P pairs of a particle and a target."""
    particle, target = pairs
    nearest = _distances(seen, half, particle, _ray_angles(seen, half, pairs, rays))  # (P, R, V)
    to_target = nearest[np.arange(len(target)), :, target]
    nearest[np.arange(len(target)), :, target] = np.inf
    clear = np.count_nonzero(nearest.min(axis=-1) >= to_target, axis=-1)
    return np.asarray(clear / rays, np.float64)


def _ray_angles(seen: Relative, half: Floats, pairs: tuple[Indices, Indices], rays: int) -> Floats:
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


def _distances(seen: Relative, half: Floats, particle: Indices, angles: Floats) -> Floats:
    """Return (P, R, V) the distance along each ray to each vehicle of the particle, inf where it misses.

    Slab test in the frame of each vehicle: a ray is inside the rectangle while it is inside both slabs.
    """
    forward, left, heading = seen.forward[particle], seen.left[particle], seen.heading[particle]
    turned = angles[..., None] - heading[:, None, :]
    cos, sin = np.cos(heading), np.sin(heading)
    origin = (-cos * forward - sin * left, sin * forward - cos * left)  # the ego's centre, for each vehicle
    enter, leave = np.zeros_like(turned), np.full_like(turned, np.inf)
    tiny = 1e-12  # replaces a component of zero, so that slabs need no special case
    for axis, direction in enumerate((np.cos(turned), np.sin(turned))):
        safe = np.where(np.abs(direction) < tiny, tiny, direction)
        start = origin[axis][:, None, :]
        first, second = (-half[:, axis] - start) / safe, (half[:, axis] - start) / safe
        enter = np.maximum(enter, np.minimum(first, second))
        leave = np.minimum(leave, np.maximum(first, second))
    return np.where(enter <= leave, enter, np.inf)
