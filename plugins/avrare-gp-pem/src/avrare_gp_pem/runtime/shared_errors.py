"""Errors that all detections share: of a calibration, of the ego's own pose, and blackouts of the sensor.

Each error is a stationary Gaussian autoregressive sequence of first order, z(t) = rho z(t - 1) +
sqrt(1 - rho^2) xi(t) with rho = exp(-dt / time), or one number for the whole rollout (rho = 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.driving import Observation, Scene, Vehicles, World
from avrare.protocols import Bools, Floats, PerceptionErrorModel, adapt
from avrare.stack.part_checks import find_noise_names, find_perfect_noise
from avrare_gp_pem.config import Blackouts, CommonErrors, PoseErrors


@dataclass(frozen=True)
class SharedMemory:
    """Shared errors of N particles.

    Attributes:
        model: Memory of the model itself, or None.
        numbers: (N, K) standard normal numbers of the errors.
        dark: (N,) the sensor sees nothing.
    """

    model: Any
    numbers: Floats
    dark: Bools


class SharedErrorPem(PerceptionErrorModel):
    """Model with shared errors; with those of the pose it also locates the ego for the planner."""

    def __init__(
        self,
        model: object,
        dt: float,
        common: CommonErrors | None,
        pose: PoseErrors | None,
        blackouts: Blackouts | None,
    ) -> None:
        self.model = model = adapt(PerceptionErrorModel, model)
        self._common, self._pose = common, pose
        common_names = ("common error along", "common error across")
        pose_names = ("pose error along", "pose error across", "pose error of heading")
        kinds = [(common, common_names), (pose, pose_names)]
        names = [name for options, channels in kinds if options is not None for name in channels]
        times = [options.time for options, channels in kinds if options is not None for _ in channels]
        decay = [1.0 if time is None else math.exp(-dt / time) for time in times]
        self._decay, self._fresh = np.array(decay), np.sqrt(1.0 - np.square(decay))
        dark = ["blackout of the sensor"] if blackouts is not None else []
        self.noise_names = (*find_noise_names(model), *names, *dark)
        self.perfect_noise = (*find_perfect_noise(model), *(0.0 for _ in names), *(8.0 for _ in dark))
        self.noise_size = len(self.noise_names)
        self._bounds: tuple[float, float] | None = None
        if blackouts is not None:
            begin, stay = -math.expm1(-dt * blackouts.rate), math.exp(-dt / blackouts.duration)
            self._bounds = NormalDist().inv_cdf(begin), NormalDist().inv_cdf(max(stay, 1e-300))
        self.ghost_slots = model.ghost_slots

    def start(self, noise: Floats) -> SharedMemory:
        """Return the memory at t = 0, in sight, from noise (N, noise_size)."""
        first, shared = self._split(noise)
        return SharedMemory(self.model.start(first), shared.copy(), np.zeros(len(noise), dtype=np.bool_))

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation without shared errors, from noise (N, noise_size)."""
        return self.model.observe(world, self._split(noise)[0])

    def follow(self, world: World, noise: Floats, memory: SharedMemory) -> tuple[Observation, SharedMemory]:
        """Return the observation of the next step and the memory after it, from noise (N, noise_size)."""
        first, shared = self._split(noise)
        observation, inner = self.model.follow(world, first, memory.model)
        later = SharedMemory(inner, self._decay * memory.numbers + self._fresh * shared, memory.dark)
        if self._bounds is not None:
            draw = noise[:, -1]
            later = replace(later, dark=draw < np.where(memory.dark, self._bounds[1], self._bounds[0]))
        return self._black_out(self._move(observation, world, later), later.dark), later

    def locate(self, ego: Vehicles, memory: SharedMemory) -> Vehicles:
        """Return the ego where the error of its pose puts it."""
        if self._pose is None:
            return ego
        x, y, heading = self._pose_error(memory).T
        return replace(ego, x=ego.x + x, y=ego.y + y, heading=ego.heading + heading)

    def _split(self, noise: Floats) -> tuple[Floats, Floats]:
        begin = self.model.noise_size
        return noise[:, :begin], noise[:, begin : begin + len(self._decay)]

    def _common_error(self, memory: SharedMemory) -> Floats:
        if self._common is None:
            return np.zeros((1, 2))
        return np.asarray(memory.numbers[:, :2] * np.array(self._common.sd))

    def _pose_error(self, memory: SharedMemory) -> Floats:
        if self._pose is None:
            return np.zeros((1, 3))
        return np.asarray(memory.numbers[:, -3:] * np.array([*self._pose.sd, self._pose.heading_sd]))

    def _move(self, seen: Observation, world: World, memory: SharedMemory) -> Observation:
        ego, shift = world.ego, self._common_error(memory)[:, :, None]
        x, y, turn = self._pose_error(memory)[:, :, None].transpose(1, 0, 2)
        cos, sin = np.cos(turn), np.sin(turn)
        ahead, aside = seen.x + shift[:, 0] - ego.x[:, None], seen.y + shift[:, 1] - ego.y[:, None]
        moved = replace(
            seen,
            x=ego.x[:, None] + x + cos * ahead - sin * aside,
            y=ego.y[:, None] + y + sin * ahead + cos * aside,
        )
        return moved if seen.heading is None else replace(moved, heading=seen.heading + turn)

    def _black_out(self, seen: Observation, dark: Bools) -> Observation:
        if not dark.any():
            return seen
        nothing: Observation = batch.map_leaves(
            lambda leaf: np.full_like(leaf, False if leaf.dtype == np.bool_ else np.nan), seen
        )
        return batch.choose(dark, nothing, seen)


def with_shared_errors(model: Any, config: Any, scene: Scene) -> Any:
    """Return ``model`` with the shared errors of its options; ``model`` itself where there are none."""
    options = (config.common, config.pose, config.blackouts)
    return model if options == (None, None, None) else SharedErrorPem(model, scene.dt, *options)
