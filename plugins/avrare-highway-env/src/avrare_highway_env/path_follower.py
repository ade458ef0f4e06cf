"""Controller along waypoints: pure pursuit, and the intelligent driver model behind vehicles on the path."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Prediction, Scene, Vehicles
from avrare.protocols import Bools, Floats
from avrare_highway_env.actions import ACCELERATION, STEERING
from avrare_highway_env.config import PathFollowerConfig
from avrare_highway_env.sensing import Ego
from avrare_highway_env.worlds import ABSENT


class Path:
    """Path of straight segments between waypoints, extended straight after the last.

    Args:
        waypoints: x and y of two or more points [m]; consecutive points differ.
    """

    def __init__(self, waypoints: Sequence[tuple[float, float]]) -> None:
        points = np.array(waypoints, dtype=np.float64)
        last = points[-1] - points[-2]
        # straight on for 10 km
        self._points = np.concatenate([points, [points[-1] + 1e4 * last / np.hypot(*last)]])
        pieces = np.diff(self._points, axis=0)
        self._lengths = np.hypot(pieces[:, 0], pieces[:, 1])
        self._units = pieces / self._lengths[:, None]
        self._begins = np.concatenate([[0.0], np.cumsum(self._lengths)])

    def project(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Project positions onto the path.

        Args:
            x: Positions of any shape [m].
            y: Positions of the same shape [m].

        Returns:
            Distance along the path from the first waypoint [m], distance to the path [m], and direction of
            the path there [rad].
        """
        dx, dy = x[..., None] - self._points[:-1, 0], y[..., None] - self._points[:-1, 1]
        ux, uy = self._units.T
        along = np.clip(dx * ux + dy * uy, 0.0, self._lengths)
        off = np.hypot(dx - along * ux, dy - along * uy)
        piece = off.argmin(axis=-1)
        chosen = piece[..., None]
        nearest_along = np.take_along_axis(along, chosen, axis=-1)[..., 0]
        nearest = np.take_along_axis(off, chosen, axis=-1)[..., 0]
        return self._begins[piece] + nearest_along, nearest, np.arctan2(uy, ux)[piece]

    def at(self, along: Floats) -> tuple[Floats, Floats]:
        """Return x and y [m] of the points at distance ``along`` [m] from the first waypoint."""
        x, y = self._points.T
        return np.interp(along, self._begins, x), np.interp(along, self._begins, y)


_LENGTH, _WIDTH = 5.0, 2.0
"""Size of every vehicle of highway-env [m]; the length is also the wheelbase."""


class PathFollower:
    """Follows a path at a cruise speed and keeps its distance to the nearest vehicle on it; no memory.

    It goes by the predictions of a tracker, and where there is none by the true states of the other vehicles;
    it does not see the lidar.

    Args:
        config: Options.
        dt: Step of the predictions [s].

    Attributes:
        horizon: Steps of predictions, up to the foresight.
    """

    def __init__(self, config: PathFollowerConfig, dt: float = 0.1) -> None:
        self.config, self.dt = config, dt
        self.horizon = max(round(config.foresight / dt), 1)
        self.path = Path(config.waypoints)

    def start(self, n: int) -> None:
        """Return no memory."""
        return

    def act(self, memory: None, ego: Ego, prediction: Prediction | None) -> tuple[Floats, None]:
        """Return throttle and steering (N, 2) in [-1, 1], left is positive.

        Raises:
            UsageError: The simulator does not provide the other vehicles.
        """
        if not isinstance(ego, Ego):
            raise UsageError(
                "the controller path_follower needs the states of the other vehicles",
                "use it with the simulator highway_env",
            )
        command = self._accelerate(ego, prediction) / ACCELERATION, self._steer(ego) / STEERING
        return np.clip(np.stack(command, axis=1), -1.0, 1.0), None

    def _steer(self, ego: Vehicles) -> Floats:
        """Return the steering angle [rad] by pure pursuit of the rear axle (Coulter, 1992)."""
        x = ego.x - 0.5 * _LENGTH * np.cos(ego.heading)
        y = ego.y - 0.5 * _LENGTH * np.sin(ego.heading)
        along, _, _ = self.path.project(x, y)
        ahead = np.maximum(self.config.least_lookahead, self.config.lookahead_time * ego.speed)
        goal_x, goal_y = self.path.at(along + ahead)
        dx, dy = goal_x - x, goal_y - y
        across = np.cos(ego.heading) * dy - np.sin(ego.heading) * dx
        return np.arctan(2.0 * _LENGTH * across / (dx**2 + dy**2))

    def _accelerate(self, ego: Ego, prediction: Prediction | None) -> Floats:
        """Return the acceleration of Treiber, Hennecke and Helbing (2000) [m/s^2]."""
        config, v = self.config, ego.speed
        gap, leader = self._leader(ego, self._foresee(ego.others, prediction))
        comfort = 2.0 * np.sqrt(config.acceleration * config.deceleration)
        room = np.maximum(v * config.time_gap + v * (v - leader) / comfort, 0.0)
        braking = ((config.standstill_gap + room) / gap) ** 2
        free = (np.maximum(v, 0.0) / config.cruise_speed) ** 4
        acceleration = config.acceleration * (1.0 - free - braking)
        return np.asarray(np.maximum(acceleration, -v / config.stopping_time))

    def _foresee(self, others: Vehicles, prediction: Prediction | None) -> Iterator[Vehicles]:
        """Yield the other vehicles at some times up to the foresight; their headings and speeds stay."""
        times = np.linspace(0.0, self.config.foresight, 4 if self.config.foresight else 1)
        if prediction is None:
            vx, vy = others.speed * np.cos(others.heading), others.speed * np.sin(others.heading)
            for time in times:
                yield replace(others, x=others.x + time * vx, y=others.y + time * vy)
            return
        x, y = (np.where(np.isfinite(place), place, ABSENT) for place in (prediction.x, prediction.y))
        dx, dy = x[..., -1] - x[..., 0], y[..., -1] - y[..., 0]
        speed = np.hypot(dx, dy) / (self.dt * self.horizon)
        _, _, direction = self.path.project(x[..., 0], y[..., 0])
        # a vehicle that stands is taken for parallel to the path
        heading = np.where(speed > 0.5, np.arctan2(dy, dx), direction)
        for time in times:
            step = min(round(time / self.dt), self.horizon)
            yield Vehicles(x[..., step], y[..., step], heading, speed, np.zeros_like(speed))

    def _leader(self, ego: Ego, foreseen: Iterable[Vehicles]) -> tuple[Floats, Floats]:
        """Return gap [m] and speed [m/s] of the nearest vehicle ahead on the path; inf and 0 if free."""
        here = self.path.project(ego.x, ego.y)[0]
        gaps, speeds = [np.full((len(here), 1), np.inf)], [np.zeros((len(here), 1))]  # free path
        for others in foreseen:
            along, off, direction = self.path.project(others.x, others.y)
            turned = others.heading - direction
            # half extents of the rectangle along and across the path
            cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
            length, width = 0.5 * (_LENGTH * cos + _WIDTH * sin), 0.5 * (_LENGTH * sin + _WIDTH * cos)
            on: Bools = (along > here[:, None]) & (off - width < 0.5 * self.config.corridor_width)
            least_gap = 0.1  # lower bound of the gap in the model [m]
            gap = np.maximum(along - here[:, None] - length - 0.5 * _LENGTH, least_gap)
            gaps.append(np.where(on, gap, np.inf))
            speeds.append(others.speed * np.cos(turned))
        gap, speed = np.concatenate(gaps, axis=1), np.concatenate(speeds, axis=1)
        rows, nearest = np.arange(len(gap)), gap.argmin(axis=1)
        return gap[rows, nearest], speed[rows, nearest]


def build(config: PathFollowerConfig, scene: Scene | None = None) -> PathFollower:
    """Build the controller of a scenario."""
    return PathFollower(config) if scene is None else PathFollower(config, scene.dt)
