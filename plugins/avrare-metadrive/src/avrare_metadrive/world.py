"""A MetaDrive world, which is a process, among those that the core runs as a batch."""

from __future__ import annotations

import functools
import os
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.simulator import Worlds
from avrare_metadrive import version
from avrare_metadrive.config import MetaDriveConfig
from avrare_metadrive.lidar import disturbed
from avrare_metadrive.process import First, Process
from avrare_metadrive.readings import DT, SIGNALS

ENGINE = "avrare_metadrive.engine"
"""The program of the processes."""
_OVER = SIGNALS.index("over")


def build(config: MetaDriveConfig, scene: object | None = None) -> Worlds:
    """The simulator of a scenario.

    Raises:
        PluginError: MetaDrive is not installed, or another version of it.
        UsageError: There can be no forks here.
    """
    version.require()
    if not hasattr(os, "fork"):
        raise UsageError("the simulator metadrive needs an operating system with fork, such as Linux")
    return Worlds(
        functools.partial(MetaDriveWorld, config), dt=DT,
        copy="hook" if config.copy_by == "fork" else "replay", step_timeout=config.step_timeout,
    )  # fmt: skip


_starts: dict[tuple[MetaDriveConfig, int], tuple[Process, Floats]] = {}


def _started(config: MetaDriveConfig) -> tuple[Process, Floats]:
    """The process of this one whose car never leaves the start, and what it sees there."""
    key = config, os.getpid()
    if key not in _starts or _starts[key][0].closed:
        process = First(ENGINE)
        _starts[key] = process, process.call("begin", config)
    return _starts[key]


class MetaDriveWorld:
    """One world (``avrare.worlds.World``): a process that was forked from one at the start of the road.

    A copied process runs on bit for bit like the first. The world stands still once its car has arrived, has
    crashed or has left the road. An action is steering and throttle in [-1, 1].

    Attributes:
        noise_size: One number a ray where they are noisy. Those of row t disturb what is seen at step t.
    """

    def __init__(self, config: MetaDriveConfig) -> None:
        self.config = config
        self.sd = float(np.sqrt(config.noise.variance))
        self.noise_size = config.lasers if self.sd else 0
        self._process: Process | None = None
        self._numbers = np.empty(0)

    def reset(self, noise: Floats) -> None:
        """Go to the start, from noise (noise_size,)."""
        start, numbers = _started(self.config)
        self._process = start.fork()
        self._see(numbers, noise)

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """The actions of N worlds, as they are.

        Raises:
            UsageError: They are not N times steering and throttle.
        """
        if np.shape(actions) != (len(noise), 2):
            raise UsageError(
                "the simulator metadrive needs a controller that gives steering and throttle",
                "controller: {plugin: metadrive_expert}",
            )
        return actions

    def step(self, action: Floats, noise: Floats) -> None:
        """Go on for 0.1 s with an action (2,)."""
        if not self._numbers[_OVER]:
            steering, throttle = action.tolist()
            self._see(self._running().call("step", steering, throttle), noise)

    def numbers(self) -> Floats:
        """(K,) signals, then what the driver sees."""
        return self._numbers

    def named(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Signals (N,) and observations (N, K - signals) of K numbers each of N worlds."""
        return dict(zip(SIGNALS, table.T.copy(), strict=False)), table[:, len(SIGNALS) :].copy()

    def signals(self) -> dict[str, Floats]:
        """Its signals, see ``readings.SIGNALS``."""
        return dict(zip(SIGNALS, self._numbers, strict=False))

    def observation(self) -> Floats:
        """What the driver sees: 35 true numbers for 240 rays, then the noisy rays."""
        return self._numbers[len(SIGNALS) :]

    def snapshot(self) -> tuple[Process, Floats]:
        """A process that sleeps where this one stands."""
        return self._running().fork(), self._numbers

    def restore(self, snapshot: tuple[Process, Floats]) -> None:
        """Go on where the snapshot was taken."""
        sleeping, self._numbers = snapshot
        self._process = sleeping.fork()

    def picture(self, width: int = 800, height: int = 300, scaling: float = 5.0) -> Any:
        """Top view of now, (height, width, 3); drawn in a copy, so that the world does not notice.

        Args:
            width: In pixels.
            height: In pixels.
            scaling: Pixels per metre.
        """
        return self._running().fork().call("picture", width, height, scaling)

    def close(self) -> None:
        """Let its process end."""
        self._process = None

    def _running(self) -> Process:
        if self._process is None:
            raise UsageError("this world has not been reset yet")
        return self._process

    def _see(self, numbers: Floats, noise: Floats) -> None:
        self._numbers = numbers.copy()
        rays = self._numbers[len(numbers) - self.config.lasers :]
        rays[:] = disturbed(rays, noise, self.sd)
