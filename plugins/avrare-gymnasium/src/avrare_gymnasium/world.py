"""One Gymnasium environment as a world."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from avrare.errors import PluginError, UsageError, did_you_mean
from avrare.protocols import Floats
from avrare_gymnasium.actions import actions
from avrare_gymnasium.config import OUTCOMES, GymnasiumConfig
from avrare_gymnasium.stream import Stream

_FREE = "its random numbers are its own (noise.stream.by: free)"
_BEGUN = [0.0, 0.0, 0.0]
"""Reward, terminated, truncated at t = 0."""


class GymWorld:
    """An environment; once it has ended it stands still, with the last signals it gave.

    A row of its noise holds the numbers of the stream, then those of the action.

    Args:
        config: Of the simulator; noise on observations and on the initial state is not its business.

    Raises:
        UsageError: There is no such environment, or an option does not fit it.
        PluginError: It needs a package that is not installed.
    """

    def __init__(self, config: GymnasiumConfig) -> None:
        self.env = _made(config)
        self.options: dict[str, Any] | None = config.reset or None
        self.initial = config.noise.initial
        self.space = self.env.observation_space
        self.nested = not isinstance(self.space, spaces.Box | spaces.Discrete)
        stream = config.noise.stream
        self.stream = Stream(stream.by, stream.at == "step", stream.numbers)
        self.actions = actions(self.env.action_space, config.noise.action)
        self.noise_size = self.stream.noise_size + self.actions.noise_size
        self.lacks = {"noise": _FREE, "branches": _FREE} if stream.by == "free" else {}
        self.size = _size(self.space)
        self.seen = [0.0] * self.size
        self.names = _names(config, len(self.seen))
        self.outcome, self.steps = _BEGUN, 0
        if hasattr(self.env.unwrapped, "snapshot") and hasattr(self.env.unwrapped, "restore"):
            self.snapshot, self.restore = self._snapshot, self._restore

    def reset(self, noise: Floats) -> None:
        """Go to t = 0, from noise (noise_size,)."""
        observation, _ = self.stream.reset(self.env, noise, self.options)
        self.seen, self.outcome, self.steps = self._flat(observation), _BEGUN, 0

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """The actions that N environments are given, from commands (N, ...) and noise (N, noise_size)."""
        return self.actions(actions, noise[:, self.stream.noise_size :])

    def step(self, action: Any, noise: Floats) -> None:
        """Go one step on, unless the environment has ended."""
        if self.outcome[1] or self.outcome[2]:
            return
        self.stream.step(self.env, noise)
        given = action.copy()  # environments may write to it
        observation, reward, terminated, truncated, _ = self.env.step(given)
        self.seen = self._flat(observation)
        self.outcome = [float(reward), float(terminated), float(truncated)]
        self.steps += 1

    def signals(self) -> Mapping[str, float]:
        """Entries of the observation by name, ``reward``, and 0 or 1 for ``terminated``, ``truncated``."""
        named = {name: self.seen[entry] for name, entry in self.names.items()}
        return named | dict(zip(OUTCOMES, self.outcome, strict=True))

    def observation(self) -> list[float]:
        """(d,) the flattened observation."""
        return self.seen

    def numbers(self) -> list[float]:
        """The observation and the outcome: ``signals`` and ``observation`` in one."""
        return self.seen + self.outcome

    def named(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """``numbers`` of N worlds as signals (N,) and observations (N, d)."""
        entries = self.names | {name: len(self.seen) + place for place, name in enumerate(OUTCOMES)}
        signals = {name: np.ascontiguousarray(table[:, entry]) for name, entry in entries.items()}
        return signals, np.ascontiguousarray(table[:, : len(self.seen)])

    def displace(self, delta: Floats) -> None:
        """Move the state after a reset.

        Raises:
            UsageError: The environment has no such attribute, or does not show what it is then like.
        """
        assert self.initial is not None  # else nobody would ask
        inner, name = self.env.unwrapped, self.initial.attribute
        before = getattr(inner, name, None)
        moved = np.asarray(before if before is not None else np.nan, dtype=np.float64) + delta
        setattr(inner, name, tuple(moved.tolist()) if isinstance(before, tuple) else moved)
        show = getattr(inner, "_get_obs", None)
        if show is None and moved.shape != (len(self.seen),):
            raise UsageError(
                f"the observation after a change of {name!r} is not known: the environment has no _get_obs()",
                "leave noise.initial out: noise.stream draws the initial state as the environment does",
            )
        self.seen = self._flat(show() if show is not None else moved)

    def close(self) -> None:
        """Let the environment go."""
        self.env.close()

    def _flat(self, observation: Any) -> list[float]:
        if not isinstance(observation, np.ndarray):
            observation = np.asarray(spaces.flatten(self.space, observation) if self.nested else observation)
        if observation.size != self.size:  # it would be read as other signals
            raise UsageError(
                f"an observation has {observation.size} number(s), the observation_space {self.size}",
                "the environment must keep to its observation_space",
            )
        return observation.ravel().tolist()  # type: ignore[no-any-return]

    def _snapshot(self) -> Any:
        inner: Any = self.env.unwrapped
        return inner.snapshot(), copy.deepcopy(inner.np_random), self.seen, self.outcome, self.steps

    def _restore(self, snapshot: Any) -> None:
        state, generator, self.seen, self.outcome, self.steps = snapshot
        inner: Any = self.env.unwrapped
        self.env.reset(seed=0)  # its wrappers want one
        inner.np_random = copy.deepcopy(generator)  # the environment's snapshot need not have it
        inner.restore(state)
        wrapper: Any = self.env
        while wrapper is not inner:
            if "_elapsed_steps" in vars(wrapper):  # the time limit
                wrapper._elapsed_steps = self.steps
            wrapper = wrapper.env


def state_size(world: GymWorld, attribute: str) -> int:
    """Numbers of the environment's initial state.

    Raises:
        UsageError: It has no such attribute, or none of numbers.
    """
    world.reset(np.zeros(world.noise_size))
    value = getattr(world.env.unwrapped, attribute, None)
    try:
        if value is None:
            raise TypeError("there is none")
        return int(np.asarray(value, dtype=np.float64).size)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"{type(world.env.unwrapped).__name__}.{attribute} is no state of numbers: {error}",
            "noise.initial.attribute names where the environment keeps its state",
        ) from None


def _made(config: GymnasiumConfig) -> gymnasium.Env[Any, Any]:
    name = config.env.rpartition(":")[2]
    if name not in gymnasium.registry and ":" not in config.env:
        raise UsageError(
            f"there is no environment {name!r}",
            did_you_mean(name, gymnasium.registry) or "see gymnasium.pprint_registry()",
        )
    try:
        return gymnasium.make(config.env, disable_env_checker=True, **config.options)
    except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
        hint = 'pip install "avrare-gymnasium[box2d]"' if "ox2" in str(error) else None
        raise PluginError(f"environment {name!r} needs a package: {error}", hint) from None
    except Exception as error:
        raise UsageError(
            f"environment {name!r} cannot be made: {type(error).__name__}: {error}",
            "`options:` are the keyword arguments of the environment",
        ) from error


def _size(space: spaces.Space[Any]) -> int:
    return 1 if isinstance(space, spaces.Discrete) else spaces.flatdim(space)


def _names(config: GymnasiumConfig, size: int) -> dict[str, int]:
    if config.signals is None:
        return {f"o{entry}": entry for entry in range(size)}
    for name, entry in config.signals.items():
        if entry >= size:
            raise UsageError(f"signals.{name}: the observation has entries 0..{size - 1}, not {entry}")
    return config.signals
