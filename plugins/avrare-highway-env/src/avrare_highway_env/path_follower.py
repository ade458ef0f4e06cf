"""A driver along waypoints: pure pursuit, and the intelligent driver model behind whatever is on the path."""

from __future__ import annotations

import numpy as np

from avrare.driving import Prediction, Vehicles
from avrare.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare_highway_env.actions import ACCELERATION, STEERING
from avrare_highway_env.path import Path
from avrare_highway_env.path_follower_config import PathFollowerConfig
from avrare_highway_env.sensing import Ego

_LENGTH, _WIDTH = 5.0, 2.0
"""Of every vehicle of highway-env [m]; the length is its wheelbase, too."""
_TOUCH = 0.1
"""Smallest gap that the model is given [m]."""
_LOOKS = 4
"""Times at which the others are looked for, up to the foresight."""


class PathFollower:
    """Follows a path at a cruise speed, and keeps its distance to the nearest vehicle on it. No memory.

    It sees the others as they are, not through the lidar.

    Attributes:
        horizon: 0, it needs no predictions.
    """

    horizon = 0

    def __init__(self, config: PathFollowerConfig) -> None:
        self.config = config
        self.path = Path(config.waypoints)

    def start(self, n: int) -> None:
        """There is no memory."""
        return

    def act(self, memory: None, ego: Ego, prediction: Prediction | None) -> tuple[Floats, None]:
        """Throttle and steering (N, 2) in [-1, 1], left is positive.

        Raises:
            UsageError: The simulator does not say where the others are.
        """
        if not isinstance(ego, Ego):
            raise UsageError(
                "the controller path_follower needs to see the other vehicles around the ego",
                "it drives in the simulator highway_env",
            )
        wanted = self._accelerate(ego) / ACCELERATION, self._steer(ego) / STEERING
        return np.clip(np.stack(wanted, axis=1), -1.0, 1.0), None

    def _steer(self, ego: Vehicles) -> Floats:
        """Pure pursuit (Coulter, 1992) of the rear axle, in the form for a bicycle: steering angle [rad]."""
        x = ego.x - 0.5 * _LENGTH * np.cos(ego.heading)
        y = ego.y - 0.5 * _LENGTH * np.sin(ego.heading)
        along, _, _ = self.path.project(x, y)
        ahead = np.maximum(self.config.least_lookahead, self.config.lookahead_time * ego.speed)
        goal_x, goal_y = self.path.at(along + ahead)
        dx, dy = goal_x - x, goal_y - y
        across = np.cos(ego.heading) * dy - np.sin(ego.heading) * dx
        return np.arctan(2.0 * _LENGTH * across / (dx**2 + dy**2))

    def _accelerate(self, ego: Ego) -> Floats:
        """Treiber, Hennecke and Helbing (2000) [m/s^2]."""
        config, v = self.config, ego.speed
        gap, leader = self._leader(ego)
        comfort = 2.0 * np.sqrt(config.acceleration * config.deceleration)
        room = np.maximum(v * config.time_gap + v * (v - leader) / comfort, 0.0)
        braking = ((config.standstill_gap + room) / gap) ** 2
        free = (np.maximum(v, 0.0) / config.cruise_speed) ** 4
        wanted = config.acceleration * (1.0 - free - braking)
        return np.asarray(np.maximum(wanted, -v / config.stopping_time))

    def _leader(self, ego: Ego) -> tuple[Floats, Floats]:
        """Gap to the nearest vehicle on the path ahead [m], inf where it is free, and its speed along it."""
        others, here = ego.others, self.path.project(ego.x, ego.y)[0]
        gaps, speeds = [np.full((len(here), 1), np.inf)], [np.zeros((len(here), 1))]  # nobody
        for later in np.linspace(0.0, self.config.foresight, _LOOKS if self.config.foresight else 1):
            x = others.x + later * others.speed * np.cos(others.heading)
            y = others.y + later * others.speed * np.sin(others.heading)
            along, off, direction = self.path.project(x, y)
            turned = others.heading - direction
            # the half shadows of its rectangle along and across the path
            cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
            length, width = 0.5 * (_LENGTH * cos + _WIDTH * sin), 0.5 * (_LENGTH * sin + _WIDTH * cos)
            on: Bools = (along > here[:, None]) & (off - width < 0.5 * self.config.corridor_width)
            gap = np.maximum(along - here[:, None] - length - 0.5 * _LENGTH, _TOUCH)
            gaps.append(np.where(on, gap, np.inf))
            speeds.append(others.speed * np.cos(turned))
        gap, speed = np.concatenate(gaps, axis=1), np.concatenate(speeds, axis=1)
        rows, nearest = np.arange(len(gap)), gap.argmin(axis=1)
        return gap[rows, nearest], speed[rows, nearest]


def build(config: PathFollowerConfig, scene: object | None = None) -> PathFollower:
    """The controller of a scenario."""
    return PathFollower(config)
