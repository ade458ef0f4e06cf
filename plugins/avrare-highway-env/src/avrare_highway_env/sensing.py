"""What the ego observes: itself and, through a noisy lidar, the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.driving import Vehicles
from avrare.driving.geometry import Rectangle
from avrare.protocols import Floats
from avrare_highway_env.config import LidarConfig
from avrare_highway_env.lidar import cast, closing, directions

FEATURES = 6
"""Numbers about the ego: x / 370 m, y / 4 m, heading, speed / 30 m/s, acceleration / 5 m/s^2, steering."""


@dataclass(frozen=True)
class Ego(Vehicles):
    """The ego, and what it observes.

    Attributes:
        steering: (N,) last steering angle, left is positive [rad].
        observation: (N, D) own features, then the rays' distances / range, then their speeds / range.
        others: Fields (N, V), as they are: for controllers that see everything.
    """

    steering: Floats
    observation: Floats
    others: Vehicles


class Sensors:
    """A lidar on the ego, or nothing.

    Attributes:
        noise_size: One number a ray where they are noisy.
        size: D, the length of an observation.
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
        """The ego with its observation, from noise (N, noise_size)."""
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
        return Ego(*fields, steering, np.concatenate(parts, axis=1), others)


def _velocity(vehicles: Vehicles) -> tuple[Floats, Floats]:
    return vehicles.speed * np.cos(vehicles.heading), vehicles.speed * np.sin(vehicles.heading)
