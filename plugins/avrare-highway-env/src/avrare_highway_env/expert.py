"""Expert driver that the merge policy imitates: full observation, car following and overtaking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_highway_env.actions import ACCELERATION, STEERING

_IN_LANE = 2.8
"""Largest distance of a vehicle in a lane from its centre [m]: half a lane and most of half a vehicle."""


@dataclass(frozen=True)
class Expert:
    """Intelligent driver model that takes the lane with the higher acceleration.

    Attributes:
        lanes: y of the centres of the left and the right lane [m].
        speed: Desired speed on a free lane [m/s].
        acceleration: Maximal acceleration [m/s^2].
        braking: Comfortable deceleration [m/s^2].
        jam: Gap at standstill, bumper to bumper [m].
        headway: Time gap [s].
        loyalty: Advantage of the current lane [m/s^2].
        room: Smallest gap to a vehicle on the target lane [m].
        foresight: Time for which the gap must last at constant speeds [s].
        length: Length of every vehicle [m].
    """

    lanes: tuple[float, float] = (0.0, -4.0)
    speed: float = 25.0
    acceleration: float = 3.0
    braking: float = 5.0
    jam: float = 4.0
    headway: float = 0.8
    loyalty: float = 0.6
    room: float = 4.0
    foresight: float = 2.0
    length: float = 5.0

    def act(self, ego: Vehicles, others: Vehicles) -> Floats:
        """Return throttle and steering (N, 2) in [-1, 1], left is positive."""
        left, right = (self._follow(ego, others, lane) for lane in self.lanes)
        middle = 0.5 * (self.lanes[0] + self.lanes[1])
        side = np.clip((ego.y - middle) / (self.lanes[0] - middle), -1.0, 1.0)
        better = left - right + self.loyalty * side > 0.0
        lane = np.where(better, self.lanes[0], self.lanes[1])
        current = np.where(side > 0.0, self.lanes[0], self.lanes[1])
        lane = np.where(self._free(ego, others, lane), lane, current)
        # Between the lanes, follow the leaders of both.
        between = np.abs(ego.y - current) > 0.5 * (4.0 - _IN_LANE)
        follow = np.where(lane == self.lanes[0], left, right)
        follow = np.where(between, np.minimum(left, right), follow)
        follow = np.minimum(follow, np.where(current == self.lanes[0], left, right))
        steer = self._steer(ego, lane)
        return np.clip(np.stack([follow / ACCELERATION, steer / STEERING], axis=1), -1.0, 1.0)

    def _follow(self, ego: Vehicles, others: Vehicles, lane: float) -> Floats:
        """Return the acceleration (N,) of Treiber, Hennecke and Helbing (2000) for the worst leader."""
        dx, v = others.x - ego.x[:, None], ego.speed[:, None]
        leads = (dx > 0.0) & (np.abs(others.y - lane) < _IN_LANE)
        gap = np.maximum(dx - self.length, 0.5)
        approach = v - others.speed * np.cos(others.heading)
        comfort = 2.0 * np.sqrt(self.acceleration * self.braking)
        desired_gap = self.jam + np.maximum(v * self.headway + v * approach / comfort, 0.0)
        braking = np.where(leads, (desired_gap / gap) ** 2, 0.0).max(axis=1, initial=0.0)
        free = (np.maximum(ego.speed, 0.0) / self.speed) ** 4
        return np.asarray(self.acceleration * (1.0 - free - braking))

    def _free(self, ego: Vehicles, others: Vehicles, lane: Floats) -> Bools:
        """Return where (N,) the lane is free now and after the foresight; the current lane always is."""
        dx = others.x - ego.x[:, None]
        later = dx + self.foresight * (others.speed - ego.speed[:, None])
        near = self.length + self.room
        blocks = np.minimum(np.abs(dx), np.abs(later)) < near
        blocks |= dx * later < 0.0
        in_lane = np.abs(others.y - lane[:, None]) < _IN_LANE
        return np.asarray(~np.any(blocks & in_lane, axis=1) | (np.abs(ego.y - lane) < 2.0))

    def _steer(self, ego: Vehicles, lane: Floats) -> Floats:
        """Return the steering angle [rad] of highway-env's cascade (offset, lateral speed, heading)."""
        v = np.maximum(ego.speed, 1.0)
        heading = np.arcsin(np.clip((lane - ego.y) / 1.2 / v, -0.12, 0.12))
        slip = np.arcsin(np.clip(0.5 * self.length / v * (heading - ego.heading) / 0.3, -0.9, 0.9))
        return np.arctan(2.0 * np.tan(slip))
