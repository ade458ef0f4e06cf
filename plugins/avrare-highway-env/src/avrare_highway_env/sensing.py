"""Observation of the ego: its own state and a noisy lidar."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.driving import ObservingEgo, Vehicles
from avrare.driving.geometry import Rectangle
from avrare.protocols import Floats
from avrare_highway_env.config import LidarConfig


def directions(cells: int) -> tuple[Floats, Floats]:
    """Return x and y of the rays (cells,): ray k points 2 pi k / cells to the left of the x axis."""
    angle = 2.0 * np.pi * np.arange(cells) / cells
    return np.cos(angle), np.sin(angle)


def cast(
    x: Floats, y: Floats, objects: Rectangle, rays: tuple[Floats, Floats], reach: float
) -> tuple[Floats, np.ndarray]:
    """Return the distance to the nearest object along every ray, and the object's index.

    Only objects whose centres are within reach count, as in highway-env's lidar.

    Args:
        x: Origins of the rays (N,) [m].
        y: Origins of the rays (N,) [m].
        objects: Rectangles with fields (N, V); absent ones are at infinity.
        rays: x and y of the rays' directions, (R,).
        reach: Range of the rays [m].

    Returns:
        Distances (N, R), ``reach`` if nothing is hit, and indices (N, R), -1 if nothing is hit.
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
        # Origin and direction of the rays in the object's frame.
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
    """Return where rays enter and leave |coordinate| <= half."""
    parallel = 1e-12  # least cosine that is not taken for 0
    safe = np.where(np.abs(towards) < parallel, parallel, towards)
    first, second = (-half - begin) / safe, (half - begin) / safe
    return np.minimum(first, second), np.maximum(first, second)


def closing(
    vx: Floats, vy: Floats, ego_vx: Floats, ego_vy: Floats, hit: np.ndarray, rays: tuple[Floats, Floats]
) -> Floats:
    """Return the radial speed (N, R) of hit objects relative to the ego, positive away [m/s]."""
    if vx.shape[1] == 0:
        return np.zeros(hit.shape)
    index = np.maximum(hit, 0)
    dvx = np.take_along_axis(vx, index, axis=1) - ego_vx[:, None]
    dvy = np.take_along_axis(vy, index, axis=1) - ego_vy[:, None]
    return np.where(hit >= 0, dvx * rays[0] + dvy * rays[1], 0.0)


FEATURES = 6
"""Own state: x / 370 m, y / 4 m, heading, speed / 30 m/s, acceleration / 5 m/s^2, steering."""


@dataclass(frozen=True)
class Ego(ObservingEgo):
    """Ego with its observation: own features, then the rays' distances / range, then their speeds / range.

    Attributes:
        steering: (N,) last steering angle, left is positive [rad].
        others: Other vehicles with fields (N, V), for controllers that see everything.
    """

    steering: Floats
    others: Vehicles


class Sensors:
    """Sensors of the ego: its own state and, optionally, a lidar.

    Attributes:
        noise_size: One number per ray if they are noisy.
        size: D, length of an observation.
    """

    def __init__(self, config: LidarConfig | None) -> None:
        self.config = config
        self.rays = directions(config.cells) if config is not None else None
        self.sd = np.sqrt(config.noise_variance) if config is not None else 0.0
        self.noise_size = config.cells if config is not None and self.sd else 0
        measured = 0 if config is None else config.cells * (1 + config.speeds)
        self.size = FEATURES + measured

    def observe(
        self,
        ego: Vehicles,
        steering: Floats,
        others: Vehicles,
        lengths: Floats,
        widths: Floats,
        noise: Floats,
    ) -> Ego:
        """Return the ego with its observation, from noise (N, noise_size)."""
        parts = [
            np.stack(
                [ego.x / 370.0, ego.y / 4.0, ego.heading, ego.speed / 30.0, ego.acceleration / 5.0, steering],
                axis=1,
            )
        ]
        if self.config is not None and self.rays is not None:
            boxes = Rectangle(others.x, others.y, others.heading, lengths, widths)
            reach = self.config.range
            distance, hit = cast(ego.x, ego.y, boxes, self.rays, reach)
            distance /= reach
            if self.noise_size:
                distance = np.clip(distance + self.sd * noise, 0.0, 1.0)
            parts.append(distance)
            if self.config.speeds:
                parts.append(closing(*_velocity(others), *_velocity(ego), hit, self.rays) / reach)
        fields = (ego.x, ego.y, ego.heading, ego.speed, ego.acceleration)
        return Ego(*fields, np.concatenate(parts, axis=1), steering, others)


def _velocity(vehicles: Vehicles) -> tuple[Floats, Floats]:
    return vehicles.speed * np.cos(vehicles.heading), vehicles.speed * np.sin(vehicles.heading)
