"""Simulator of a tank: Torricelli outflow, and an inflow whose logarithm is a stationary AR(1) process."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats, Signals, Simulator
from avrare_example.config import TankConfig


@dataclass(frozen=True)
class TankWorld:
    """State of N tanks.

    Attributes:
        level: (N,) height of the water above the valve [m].
        surge: (N,) logarithm of the ratio of the inflow to its median.
        spilled: (N,) volume that flowed over the rim in the last step [m^3].
    """

    level: Floats
    surge: Floats
    spilled: Floats


class Tank(Simulator):
    """Water tank whose inflow is driven by the noise.

    Args:
        config: Options.
    """

    noise_size = 1
    noise_names = ("surge of the inflow",)

    def __init__(self, config: TankConfig) -> None:
        self.config = config
        self.dt = config.dt
        self._decay = math.exp(-config.dt / config.memory)
        self._innovation = config.surge * math.sqrt(1.0 - self._decay**2)

    def reset(self, noise: Floats) -> TankWorld:
        """Return the world at t = 0 from noise (N, 1); the inflow has its stationary distribution."""
        zeros = np.zeros(len(noise))
        return TankWorld(zeros + self.config.start, self.config.surge * noise[:, 0], zeros)

    def step(self, world: TankWorld, action: object, noise: Floats) -> TankWorld:
        """Return the world one ``dt`` later; the action is ignored."""
        config = self.config
        surge = self._decay * world.surge + self._innovation * noise[:, 0]
        gravity = 9.81  # gravitational acceleration [m/s^2]
        outflow = config.valve * np.sqrt(2.0 * gravity * world.level)
        level = world.level + self.dt * (self._inflow(surge) - outflow) / config.area
        over = np.maximum(level - config.rim, 0.0)
        return TankWorld(np.clip(level, 0.0, config.rim), surge, over * config.area)

    def signals(self, world: TankWorld) -> Signals:
        """Return the signals ``level`` [m], ``inflow`` [m^3/s] and ``spilled`` [m^3], each (N,)."""
        return {"level": world.level, "inflow": self._inflow(world.surge), "spilled": world.spilled}

    def _inflow(self, surge: Floats) -> Floats:
        return np.asarray(self.config.inflow * np.exp(surge))


def build(config: TankConfig, scene: object | None = None) -> Tank:
    """Build the simulator of a scenario.

    Raises:
        UsageError: The initial level is above the rim.
    """
    if config.start > config.rim:
        raise UsageError(f"start ({config.start:g} m) is above the rim ({config.rim:g} m)")
    return Tank(config)
