"""Actions of a space from a controller's commands, with noise."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.special_functions import uniform_from_normal
from avrare.protocols import Floats
from avrare.worlds.noisy_world import Channel
from avrare_gymnasium.config import ActionNoiseConfig

Numbers = NDArray[np.floating | np.integer]
Commands = Numbers | None
"""Commands (N, ...) of a controller, None where there is none."""


class Actions(Protocol):
    """Map from a controller's commands to the actions of environments."""

    noise_size: int

    def __call__(self, commands: Commands, noise: Floats) -> NDArray[np.generic]:
        """Return actions (N, ...) from commands (N, ...) or None, and noise (N, noise_size)."""


def actions(space: spaces.Space[object], noise: ActionNoiseConfig | None) -> Actions:
    """Return the map for a space.

    Raises:
        UsageError: The space is neither discrete nor a box, or the noise does not fit it.
    """
    if isinstance(space, spaces.Discrete):
        return DiscreteActions(space, noise)
    if isinstance(space, spaces.Box):
        return BoxActions(space, noise)
    raise UsageError(f"action spaces of type {type(space).__name__} are not supported", "use Discrete or Box")


class _NoisyActions:
    """Noise of actions.

    Args:
        noise: Options; None for no noise.
        size: Numbers of additive noise per action.
        replacement: Noise numbers per random action.
    """

    def __init__(self, noise: ActionNoiseConfig | None, size: int, replacement: int) -> None:
        self.chance = noise.probability if noise is not None else None
        self.channel: Channel | None = None
        if noise is not None and noise.law != "random" and noise.scale is not None:
            self.channel = Channel(size, noise.scale, noise.law)
        self.noise_size = replacement if self.chance is not None else size if self.channel is not None else 0

    def _is_replaced(self, commands: Commands, noise: Floats) -> NDArray[np.bool_]:
        replaced = np.zeros(len(noise), dtype=bool)
        if self.chance is not None:
            replaced = np.asarray(_uniforms(noise[:, 0]) < self.chance) | (self.chance == 1.0)
        if commands is None and not replaced.all():
            hint = "add a `controller:`, or noise on the action with law random and probability 1"
            raise UsageError("this environment needs a controller", hint)
        # A comparison would turn NaN into some action.
        if commands is not None and commands.dtype.kind == "f" and np.isnan(commands).any():
            raise ValueError("the controller's command is NaN")
        return replaced


class DiscreteActions(_NoisyActions):
    """Actions of a discrete space.

    An integer command is the action itself. Real commands are one score per action, of which the greatest
    wins; for two actions, a single number that selects the second action if positive. Additive noise needs
    real commands.
    """

    def __init__(self, space: spaces.Discrete[np.int64], noise: ActionNoiseConfig | None) -> None:
        self.count, self.first = int(space.n), int(space.start)
        self.width = 1 if self.count == 2 else self.count
        super().__init__(noise, self.width, replacement=2)

    def __call__(self, commands: Commands, noise: Floats) -> NDArray[np.generic]:
        """Return integer actions (N,)."""
        replaced = self._is_replaced(commands, noise)
        if commands is None:
            chosen = np.full(len(noise), self.first)
        else:
            chosen = self._choose(np.reshape(commands, (len(noise), -1)), noise)
        if self.chance is None:
            return chosen
        other = np.minimum((self.count * _uniforms(noise[:, 1])).astype(np.int64), self.count - 1)
        return np.where(replaced, self.first + other, chosen)

    def _choose(self, commands: Numbers, noise: Floats) -> NDArray[np.generic]:
        if commands.dtype.kind in "iu" and commands.shape[1] == 1:
            return self._number(commands[:, 0])
        if commands.shape[1] != self.width:
            raise UsageError(
                f"the command has {commands.shape[1]} numbers, but {self.count} actions need {self.width}",
                "two actions: one number, positive for the second; more: one score per action",
            )
        if self.channel is not None:
            commands = commands + self.channel(noise)
        if self.count == 2:
            return self.first + (commands[:, 0] > 0.0).astype(np.int64)
        return np.asarray(self.first + np.argmax(commands, axis=1))

    def _number(self, chosen: Numbers) -> NDArray[np.generic]:
        if self.channel is not None:
            raise UsageError(
                "additive noise does not apply to integer actions", "use law: random, which replaces them"
            )
        last = self.first + self.count - 1
        if chosen.min() < self.first or chosen.max() > last:
            raise UsageError(f"actions {chosen.min()}..{chosen.max()} are outside {self.first}..{last}")
        return chosen


class BoxActions(_NoisyActions):
    """Actions of a box: the commands with noise, clipped to the bounds."""

    def __init__(self, space: spaces.Box, noise: ActionNoiseConfig | None) -> None:
        self.low, self.high = space.low.astype(np.float64), space.high.astype(np.float64)
        self.shape, self.dtype, size = space.shape, space.dtype, int(np.prod(space.shape))
        super().__init__(noise, size, replacement=1 + size)
        if self.chance is not None and not space.is_bounded():
            raise UsageError("law random needs a bounded space", "use a law with a scale")

    def __call__(self, commands: Commands, noise: Floats) -> NDArray[np.generic]:
        """Return actions (N, *shape)."""
        shape = (len(noise), *self.shape)
        if commands is not None and np.size(commands) != len(noise) * self.low.size:
            size = np.size(commands) // len(noise)
            raise UsageError(
                f"an action has the size {self.low.size}, the controller's command {size}",
                "`gain` needs one row and `action` one entry per number",
            )
        replaced = self._is_replaced(commands, noise)
        chosen = np.zeros(shape) if commands is None else np.reshape(commands, shape)
        if self.channel is not None:
            chosen = chosen + self.channel(noise).reshape(shape)
        chosen = np.minimum(np.maximum(chosen, self.low), self.high)
        if self.chance is not None:
            other = self.low + _uniforms(noise[:, 1:]).reshape(shape) * (self.high - self.low)
            chosen = np.where(replaced.reshape(-1, *(1 for _ in self.shape)), other, chosen)
        return chosen.astype(self.dtype)


def _uniforms(normals: Floats) -> Floats:
    return np.array([uniform_from_normal(z) for z in normals.ravel().tolist()]).reshape(normals.shape)
