"""From a controller's commands to the actions of a space, with noise on them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.channel import Channel, uniform
from avrare_gymnasium.config import ActionNoiseConfig

_NO_CONTROLLER = "add a `controller:`, or noise on the action with law random and probability 1"


class Actions(Protocol):
    """What environments are given for what a controller says."""

    noise_size: int

    def __call__(self, commands: Any, noise: Floats) -> NDArray[Any]:
        """Actions (N, ...) from commands (N, ...), None without a controller, and noise (N, noise_size)."""


def actions(space: spaces.Space[Any], noise: ActionNoiseConfig | None) -> Actions:
    """Those of a space.

    Raises:
        UsageError: The space is neither discrete nor a box, or the noise does not fit it.
    """
    if isinstance(space, spaces.Discrete):
        return DiscreteActions(space, noise)
    if isinstance(space, spaces.Box):
        return BoxActions(space, noise)
    raise UsageError(f"actions of a {type(space).__name__} space are not known here", "Discrete and Box are")


class DiscreteActions:
    """An integer is the number of the action. Real commands are one score for each action, the greatest wins.

    For two actions they are one number: the second action where it is positive. Noise of additive laws needs
    real commands.
    """

    def __init__(self, space: spaces.Discrete[Any], noise: ActionNoiseConfig | None) -> None:
        self.count, self.first = int(space.n), int(space.start)
        self.width = 1 if self.count == 2 else self.count
        self.chance = noise.probability if noise is not None else None
        self.channel = _channel(noise, self.width)
        self.noise_size = 2 if self.chance is not None else self.width if self.channel is not None else 0

    def __call__(self, commands: Any, noise: Floats) -> NDArray[Any]:
        """Numbers of actions (N,)."""
        replaced = _replaced(self.chance, noise)
        if commands is None:
            chosen = np.full(len(noise), self.first)
            _check_all(replaced)
        else:
            _check_numbers(commands)
            chosen = self._chosen(np.reshape(commands, (len(noise), -1)), noise)
        if self.chance is None:
            return chosen
        other = np.minimum((self.count * _shares(noise[:, 1])).astype(np.int64), self.count - 1)
        return np.where(replaced, self.first + other, chosen)

    def _chosen(self, commands: NDArray[Any], noise: Floats) -> NDArray[Any]:
        if commands.dtype.kind in "iu" and commands.shape[1] == 1:
            return self._numbered(commands[:, 0])
        if commands.shape[1] != self.width:
            raise UsageError(
                f"a command for {self.count} actions has {self.width} number(s), not {commands.shape[1]}",
                "two actions: one number, the second where it is positive; more: a score for each",
            )
        if self.channel is not None:
            commands = commands + self.channel(noise)
        if self.count == 2:
            return self.first + (commands[:, 0] > 0.0).astype(np.int64)
        return np.asarray(self.first + np.argmax(commands, axis=1))

    def _numbered(self, chosen: NDArray[Any]) -> NDArray[Any]:
        if self.channel is not None:
            raise UsageError(
                "noise cannot be added to a numbered action", "law: random puts another in place"
            )
        last = self.first + self.count - 1
        if chosen.min() < self.first or chosen.max() > last:
            raise UsageError(f"actions {chosen.min()}..{chosen.max()} are not all among {self.first}..{last}")
        return chosen


class BoxActions:
    """The commands themselves, with noise, cut to the bounds of the box."""

    def __init__(self, space: spaces.Box, noise: ActionNoiseConfig | None) -> None:
        self.low, self.high = space.low.astype(np.float64), space.high.astype(np.float64)
        self.shape, self.dtype, size = space.shape, space.dtype, int(np.prod(space.shape))
        self.chance = noise.probability if noise is not None else None
        if self.chance is not None and not space.is_bounded():
            raise UsageError("law random needs a bounded space", "give the action a law with a scale")
        self.channel = _channel(noise, size)
        self.noise_size = 1 + size if self.chance is not None else size if self.channel is not None else 0

    def __call__(self, commands: Any, noise: Floats) -> NDArray[Any]:
        """Actions (N, *shape)."""
        replaced, shape = _replaced(self.chance, noise), (len(noise), *self.shape)
        if commands is None:
            chosen = np.zeros(shape)
            _check_all(replaced)
        elif np.size(commands) != len(noise) * self.low.size:
            found = np.size(commands) // len(noise)
            raise UsageError(
                f"an action here has {self.low.size} number(s), the controller's command {found}",
                "`gain` has one row and `action` one entry for each",
            )
        else:
            _check_numbers(commands)
            chosen = np.reshape(commands, shape)
        if self.channel is not None:
            chosen = chosen + self.channel(noise).reshape(shape)
        chosen = np.minimum(np.maximum(chosen, self.low), self.high)
        if self.chance is not None:
            other = self.low + _shares(noise[:, 1:]).reshape(shape) * (self.high - self.low)
            chosen = np.where(replaced.reshape(-1, *(1 for _ in self.shape)), other, chosen)
        return chosen.astype(self.dtype)


def _replaced(chance: float | None, noise: Floats) -> NDArray[np.bool_]:
    """(N,) where another action takes the place of the controller's."""
    if chance is None:
        return np.zeros(len(noise), dtype=bool)
    return np.asarray(_shares(noise[:, 0]) < chance) | (chance == 1.0)


def _check_all(replaced: NDArray[np.bool_]) -> None:
    if not replaced.all():
        raise UsageError("this environment needs a controller", _NO_CONTROLLER)


def _check_numbers(commands: NDArray[Any]) -> None:
    """An error of the rollout: a comparison would make some action of it, and hide it."""
    if commands.dtype.kind == "f" and np.isnan(commands).any():
        raise ValueError("the controller's command is NaN")


def _shares(normals: Floats) -> Floats:
    """Uniform numbers in [0, 1] from normal ones."""
    return np.array([uniform(z) for z in normals.ravel().tolist()]).reshape(normals.shape)


def _channel(noise: ActionNoiseConfig | None, size: int) -> Channel | None:
    if noise is None or noise.law == "random" or noise.scale is None:
        return None
    return Channel(size, noise.scale, noise.law)
