"""World with additive noise on its actions, observations or initial state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.special_functions import uniform_from_normal
from avrare.protocols import Floats, adapt, overrides
from avrare.worlds.world import World, close, read_observation

Law = Literal["normal", "uniform", "laplace"]


def _symmetric_from_normal(normal: float) -> float:
    return 2.0 * uniform_from_normal(normal) - 1.0


def _laplace_from_normal(normal: float) -> float:
    tail = 0.5 * math.erfc(abs(normal) / math.sqrt(2.0))
    return math.copysign(-math.log(max(2.0 * tail, 5e-324)), normal)


@dataclass(frozen=True)
class Channel:
    """Additive noise on ``size`` numbers.

    Attributes:
        size: Number of numbers with noise.
        scale: Standard deviation (normal), half width (uniform), mean size (laplace: heavy tails); one for
            all, or one for each.
        law: Distribution of the noise.

    Raises:
        UsageError: There is not one scale for each number, one is below 0, or the law is unknown.
    """

    size: int
    scale: float | tuple[float, ...] = 1.0
    law: Law = "normal"

    def __post_init__(self) -> None:
        if isinstance(self.scale, tuple) and len(self.scale) != self.size:
            raise UsageError(f"{len(self.scale)} scales for {self.size} numbers", "give one, or one for each")
        if not np.all((np.asarray(self.scale) >= 0.0) & np.isfinite(self.scale)):
            raise UsageError(f"a scale of noise must be 0 or a finite number above it, not {self.scale!r}")
        if self.law not in get_args(Law):
            raise UsageError(f"unknown law {self.law!r} of noise", did_you_mean(self.law, get_args(Law)))

    def __call__(self, normals: Floats) -> Any:
        """Return the noise (..., size) from standard normals (..., size)."""
        if self.law == "normal":
            return np.asarray(self.scale) * normals
        shape = _laplace_from_normal if self.law == "laplace" else _symmetric_from_normal
        values = [shape(normal) for normal in np.ravel(normals).tolist()]
        return np.asarray(self.scale) * np.reshape(values, np.shape(normals))


class Noisy(World):
    """World whose actions, observations or initial state are disturbed; its signals stay the true ones.

    A row of its noise holds the world's own numbers, then those of the channels in the order of the
    arguments. The initial state is displaced after the reset, with the numbers of row 0.

    Args:
        world: World to disturb.
        action: Noise added to every action.
        observation: Noise added to the observation.
        initial: Noise passed to the world's ``displace``.

    Raises:
        UsageError: The world has no ``displace``.
    """

    def __init__(
        self,
        world: object,
        *,
        action: Channel | None = None,
        observation: Channel | None = None,
        initial: Channel | None = None,
    ) -> None:
        self.world = adapt(World, world)
        if initial is not None and not overrides(self.world, World.displace):
            raise UsageError(f"{type(world).__name__} has no displace(delta) to change its initial state")
        self.action, self.observed, self.start = action, observation, initial
        self._begin: list[int] = [int(self.world.noise_size)]
        names = list(self.world.noise_names or (f"noise {k}" for k in range(self._begin[0])))
        disturbed = {"action": action, "observation": observation, "initial state": initial}
        for what, channel in disturbed.items():
            size = channel.size if channel is not None else 0
            self._begin.append(self._begin[-1] + size)
            names += [f"{what} noise{f' {k}' if size > 1 else ''}" for k in range(size)]
        self.noise_size, self.noise_names = self._begin[-1], tuple(names)
        self._error: Any = 0.0
        self.lacks = self.world.lacks

    def reset(self, noise: Floats) -> None:
        """Reset to t = 0, from noise (noise_size,)."""
        self.world.reset(noise[: self._begin[0]])
        if self.start is not None:
            self.world.displace(self.start(noise[self._begin[2] :]))
        self._draw_error(noise)

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """Return the disturbed actions of N worlds."""
        if self.action is not None:
            size = 0 if actions is None else np.size(actions) // len(noise)
            if size != self.action.size:
                raise UsageError(f"noise on {self.action.size} numbers of an action, which has {size}")
            delta = self.action(noise[:, self._begin[0] : self._begin[1]])
            actions = actions + np.reshape(delta, np.shape(actions))
        return self.world.prepare(actions, noise[:, : self._begin[0]])

    def step(self, action: object, noise: Floats) -> None:
        """Advance by one step with a prepared action."""
        self.world.step(action, noise[: self._begin[0]])
        self._draw_error(noise)

    def signals(self) -> Mapping[str, object]:
        """Return the world's own signals."""
        return self.world.signals()

    def observation(self) -> Any:
        """Return the disturbed observation (d,)."""
        observation = read_observation(self.world, self.world.signals())
        return observation if self.observed is None else np.asarray(observation) + self._error

    def assign(self, values: Mapping[str, float]) -> None:
        """Hand values of options on to the world."""
        self.world.assign(values)

    def snapshot(self) -> object:
        """Return a copy of the world's state and of the error of its observation."""
        return self.world.snapshot(), self._error

    def restore(self, snapshot: Any) -> None:
        """Continue from a copy."""
        inner, self._error = snapshot
        self.world.restore(inner)

    def close(self) -> None:
        """Release the world."""
        close(self.world)

    def _draw_error(self, noise: Floats) -> None:
        if self.observed is not None:
            self._error = self.observed(noise[self._begin[1] : self._begin[2]])
