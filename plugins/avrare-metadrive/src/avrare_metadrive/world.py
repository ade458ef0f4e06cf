"""MetaDrive world: one process per world, run by the core as a batch."""

from __future__ import annotations

import functools
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.world import World
from avrare.worlds.worlds_simulator import Worlds
from avrare_metadrive import version
from avrare_metadrive.config import DT, SIGNALS, MetaDriveConfig
from avrare_metadrive.process import Process, RootProcess

ENGINE = "avrare_metadrive.engine"
"""Module that the processes run."""


def build(config: MetaDriveConfig, scene: object | None = None) -> Worlds:
    """Build the simulator of a scenario.

    Raises:
        PluginError: The supported version of MetaDrive is not installed.
        UsageError: The operating system has no fork.
    """
    version.check_supported()
    if not hasattr(os, "fork"):
        raise UsageError("the simulator metadrive needs an operating system with fork, such as Linux")
    return Worlds(
        functools.partial(MetaDriveWorld, config),
        dt=DT,
        copy="hook" if config.copy_by == "fork" else "replay",
        step_timeout=config.step_timeout,
    )


_roots: dict[tuple[MetaDriveConfig, int], tuple[Process, Floats]] = {}


def _root_process(config: MetaDriveConfig) -> tuple[Process, Floats]:
    """Return the process whose car stays at the start, and its numbers there; one per Python process."""
    key = config, os.getpid()
    if key not in _roots or _roots[key][0].closed:
        process = RootProcess(ENGINE)
        _roots[key] = process, process.call("begin", config)
    return _roots[key]


class MetaDriveWorld(World):
    """World (``avrare.worlds.World``) in a process forked from one at the start of the road.

    A copied process continues bit-identically. The world stops once its car has arrived, crashed or left the
    road. An action is steering and throttle in [-1, 1].

    Attributes:
        noise_size: One number per ray if they are noisy. Row t disturbs the observation at step t.
    """

    has_table = True

    def __init__(self, config: MetaDriveConfig) -> None:
        self.config = config
        self.sd = float(np.sqrt(config.noise.variance))
        self.noise_size = config.lasers if self.sd else 0
        self._process: Process | None = None
        self._numbers = np.empty(0)

    def reset(self, noise: Floats) -> None:
        """Reset to the start with noise (noise_size,)."""
        start, numbers = _root_process(self.config)
        self._process = start.fork()
        self._see(numbers, noise)

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """Check and return the actions (N, 2) of N worlds.

        Raises:
            UsageError: They are not steering and throttle.
        """
        if np.shape(actions) != (len(noise), 2):
            raise UsageError(
                "the simulator metadrive needs a controller that returns steering and throttle",
                "controller: {plugin: metadrive_expert}",
            )
        return actions

    def step(self, action: Floats, noise: Floats) -> None:
        """Advance by 0.1 s with an action (2,)."""
        if not self._numbers[SIGNALS.index("over")]:
            steering, throttle = action.tolist()
            self._see(self._running().call("step", steering, throttle), noise)

    def numbers(self) -> Floats:
        """Return the signals, then the observation, (K,)."""
        return self._numbers

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Split the numbers (N, K) of N worlds into signals (N,) and observations."""
        return dict(zip(SIGNALS, table.T.copy(), strict=False)), table[:, len(SIGNALS) :].copy()

    def signals(self) -> dict[str, Floats]:
        """Return the signals, see ``readings.SIGNALS``."""
        return dict(zip(SIGNALS, self._numbers, strict=False))

    def observation(self) -> Floats:
        """Return the observation: 35 exact numbers for 240 rays, then the noisy rays."""
        return self._numbers[len(SIGNALS) :]

    def snapshot(self) -> tuple[Process, Floats]:
        """Return a suspended copy of the process, and the numbers."""
        return self._running().fork(), self._numbers

    def restore(self, snapshot: tuple[Process, Floats]) -> None:
        """Continue from a snapshot."""
        suspended, self._numbers = snapshot
        self._process = suspended.fork()

    def picture(self, width: int = 800, height: int = 300, scaling: float = 5.0) -> NDArray[np.uint8]:
        """Return a top view (height, width, 3), drawn in a copy so that the world is unaffected.

        Args:
            width: Width [pixels].
            height: Height [pixels].
            scaling: Scale [pixels/m].
        """
        picture: NDArray[np.uint8] = self._running().fork().call("picture", width, height, scaling)
        return picture

    def close(self) -> None:
        """End the process."""
        self._process = None

    def _running(self) -> Process:
        if self._process is None:
            raise UsageError("the world has not been reset")
        return self._process

    def _see(self, numbers: Floats, noise: Floats) -> None:
        self._numbers = numbers.copy()
        rays = self._numbers[len(numbers) - self.config.lasers :]
        rays[:] = disturb(rays, noise, self.sd)


def disturb(distances: Floats, normals: Floats, sd: float) -> Floats:
    """Sample N(distance, sd^2) truncated to [0, 1] by inversion of its distribution function.

    Increasing in the normals and accurate in both tails.

    Args:
        distances: (...) true distances / range, in [0, 1].
        normals: (...) standard normal numbers.
        sd: Standard deviation before truncation, in units of the range; 0: no noise.
    """
    if sd == 0.0:
        return distances
    below, above = ndtr(-distances / sd), ndtr((distances - 1.0) / sd)
    within = 1.0 - below - above
    # Invert from the nearer tail: a probability next to 1 has lost its digits.
    lower = ndtri(below + within * ndtr(normals))
    upper = -ndtri(above + within * ndtr(-normals))
    read: Floats = distances + sd * np.where(normals < 0.0, lower, upper)
    return np.clip(read, 0.0, 1.0)
