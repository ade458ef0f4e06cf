"""Gymnasium environment as a world."""

from __future__ import annotations

import copy
import functools
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from avrare.base.errors import PluginError, UsageError, did_you_mean
from avrare.protocols import Floats
from avrare.worlds.noisy_world import Channel, Noisy
from avrare.worlds.world import World
from avrare.worlds.worlds_simulator import DrawnWorlds
from avrare_gymnasium.actions import Commands, actions
from avrare_gymnasium.config import OUTCOMES, GymnasiumConfig
from avrare_gymnasium.registration import register_installed_environments
from avrare_gymnasium.stream import Stream

_FREE = "its random numbers are not controlled by the noise (noise.stream.by: free)"
_INITIAL_OUTCOME = [0.0, 0.0, 0.0]
"""Reward, terminated, truncated at t = 0."""


class GymWorld(World):
    """One environment; after its end it keeps its last signals.

    A row of noise contains the numbers of the stream, then those of the action.

    Args:
        config: Options of the simulator; noise on observations and on the initial state is added elsewhere.

    Raises:
        UsageError: The environment does not exist, or an option does not fit it.
        PluginError: The environment needs a package that is not installed.
    """

    has_table = True

    def __init__(self, config: GymnasiumConfig) -> None:
        self.env = _make_environment(config)
        self.options: dict[str, Any] | None = config.reset or None
        self.initial = config.noise.initial
        self.attributes = dict(config.attributes)
        for name in self.attributes:
            _check_number(self.env.unwrapped, name)
        self.space = self.env.observation_space
        self.nested = not isinstance(self.space, spaces.Box | spaces.Discrete)
        stream = config.noise.stream
        self.stream = Stream(stream.by, stream.at == "step", stream.numbers)
        self.actions = actions(self.env.action_space, config.noise.action)
        sizes = {"random number": self.stream.noise_size, "action noise": self.actions.noise_size}
        self.noise_size = sum(sizes.values())
        self.noise_names = tuple(
            f"{name} {k}" if size > 1 else name for name, size in sizes.items() for k in range(size)
        )
        self.lacks = {"noise": _FREE, "branches": _FREE} if stream.by == "free" else {}
        self.size = 1 if isinstance(self.space, spaces.Discrete) else spaces.flatdim(self.space)
        self.observed = [0.0] * self.size
        self.names = _names(config, len(self.observed))
        self.outcome, self.steps = _INITIAL_OUTCOME, 0
        if hasattr(self.env.unwrapped, "snapshot") and hasattr(self.env.unwrapped, "restore"):
            vars(self).update(snapshot=self._snapshot, restore=self._restore)

    def reset(self, noise: Floats) -> None:
        """Reset to t = 0 with noise (noise_size,)."""
        for name, value in self.attributes.items():
            setattr(self.env.unwrapped, name, value)
        observation, _ = self.stream.reset(self.env, noise, self.options)
        self.observed, self.outcome, self.steps = self._flat(observation), _INITIAL_OUTCOME, 0

    def assign(self, values: Mapping[str, float]) -> None:
        """Take drawn numbers of the environment, by their place in the options."""
        self.attributes |= {path.removeprefix("attributes."): value for path, value in values.items()}

    def prepare(self, actions: Commands, noise: Floats) -> NDArray[np.generic]:
        """Return the actions of N environments from commands (N, ...) and noise (N, noise_size)."""
        return self.actions(actions, noise[:, self.stream.noise_size :])

    def step(self, action: NDArray[np.generic], noise: Floats) -> None:
        """Advance by one step unless the environment has ended."""
        if self.outcome[1] or self.outcome[2]:
            return
        self.stream.step(self.env, noise)
        # Environments may write to the action.
        observation, reward, terminated, truncated, _ = self.env.step(action.copy())
        self.observed = self._flat(observation)
        self.outcome = [float(reward), float(terminated), float(truncated)]
        self.steps += 1

    def signals(self) -> Mapping[str, float]:
        """Return entries of the observation, ``reward``, and ``terminated``, ``truncated`` as 0 or 1."""
        named = {name: self.observed[entry] for name, entry in self.names.items()}
        return named | dict(zip(OUTCOMES, self.outcome, strict=True))

    def observation(self) -> list[float]:
        """Return the flattened observation (d,)."""
        return self.observed

    def numbers(self) -> list[float]:
        """Return the observation and the outcome: ``observation`` and ``signals`` in one list."""
        return self.observed + self.outcome

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Return the ``numbers`` of N worlds as signals (N,) and observations (N, d)."""
        entries = self.names | {name: len(self.observed) + place for place, name in enumerate(OUTCOMES)}
        signals = {name: np.ascontiguousarray(table[:, entry]) for name, entry in entries.items()}
        return signals, np.ascontiguousarray(table[:, : len(self.observed)])

    def displace(self, delta: Floats) -> None:
        """Add ``delta`` to the state after a reset.

        Raises:
            UsageError: The observation of the changed state is not known.
        """
        assert self.initial is not None  # displaced only with noise.initial
        inner, name = self.env.unwrapped, self.initial.attribute
        before = getattr(inner, name)
        moved = np.asarray(before if before is not None else np.nan, dtype=np.float64) + delta
        setattr(inner, name, tuple(moved.tolist()) if isinstance(before, tuple) else moved)
        observe = getattr(inner, "_get_obs", None)
        if observe is None and moved.shape != (len(self.observed),):
            raise UsageError(
                f"the observation after a change of {name!r} is unknown: the environment has no _get_obs()",
                "remove noise.initial: noise.stream draws the initial state as the environment does",
            )
        self.observed = self._flat(observe() if observe is not None else moved)

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def _flat(self, observation: object) -> list[float]:
        if not isinstance(observation, np.ndarray):
            observation = np.asarray(spaces.flatten(self.space, observation) if self.nested else observation)
        if observation.size != self.size:  # the entries would be read as other signals
            raise UsageError(
                f"an observation has the size {observation.size}, the observation_space {self.size}",
                "the environment must follow its observation_space",
            )
        numbers: list[float] = observation.ravel().tolist()
        return numbers

    def _snapshot(self) -> object:
        inner: Any = self.env.unwrapped
        numbers = self.observed, self.outcome, self.steps, dict(self.attributes)
        return inner.snapshot(), copy.deepcopy(inner.np_random), *numbers

    def _restore(self, snapshot: Any) -> None:
        state, generator, self.observed, self.outcome, self.steps, attributes = snapshot
        inner: Any = self.env.unwrapped
        self.attributes = dict(attributes)
        for name, value in self.attributes.items():
            setattr(inner, name, value)
        self.env.reset(seed=0)  # required by its wrappers
        inner.np_random = copy.deepcopy(generator)  # may be missing in the snapshot
        inner.restore(state)
        wrapper: Any = self.env
        while wrapper is not inner:
            if "_elapsed_steps" in vars(wrapper):  # the time limit
                wrapper._elapsed_steps = self.steps
            wrapper = wrapper.env


def state_size(world: GymWorld, attribute: str) -> int:
    """Return the size of the environment's initial state.

    Raises:
        UsageError: The attribute does not exist, or is not numeric.
    """
    world.reset(np.zeros(world.noise_size))
    try:
        value = getattr(world.env.unwrapped, attribute)
        if value is None:
            raise TypeError("it is None")
        return int(np.asarray(value, dtype=np.float64).size)
    except (AttributeError, TypeError, ValueError) as error:
        raise UsageError(
            f"{type(world.env.unwrapped).__name__}.{attribute} is not a numeric state: {error}",
            "noise.initial.attribute names the attribute that holds the state",
        ) from None


def _check_number(environment: object, name: str) -> None:
    value = getattr(environment, name, None)
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        numbers = [
            key
            for key, attribute in vars(environment).items()
            if isinstance(attribute, int | float | np.number) and not isinstance(attribute, bool)
        ]
        text = f"attributes.{name}: {type(environment).__name__} has no number of this name"
        raise UsageError(text, did_you_mean(name, numbers) or "it has none")
    try:
        setattr(environment, name, value)
    except AttributeError:
        text = f"attributes.{name}: {type(environment).__name__} computes it, so it cannot be set"
        raise UsageError(text, "set the numbers that it is computed from") from None


def _make_environment(config: GymnasiumConfig) -> gymnasium.Env[object, object]:
    name = config.env.rpartition(":")[2]
    if name not in gymnasium.registry and ":" not in config.env:
        faults = register_installed_environments()
        if name not in gymnasium.registry:
            near = did_you_mean(name, gymnasium.registry) or "see gymnasium.pprint_registry()"
            raise UsageError(f"unknown environment {name!r}", "; ".join([near, *faults]))
    try:
        return gymnasium.make(config.env, disable_env_checker=True, **config.options)
    except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
        hint = 'pip install "avrare-gymnasium[box2d]"' if "ox2" in str(error) else None
        raise PluginError(f"environment {name!r} needs a package: {error}", hint) from None
    except Exception as error:
        raise UsageError(
            f"environment {name!r} cannot be created: {type(error).__name__}: {error}",
            "`options` are the keyword arguments of the environment",
        ) from error


def _names(config: GymnasiumConfig, size: int) -> dict[str, int]:
    if config.signals is None:
        return {f"o{entry}": entry for entry in range(size)}
    for name, entry in config.signals.items():
        if entry >= size:
            raise UsageError(f"signals.{name}: the observation has entries 0..{size - 1}, not {entry}")
    return config.signals


def build(config: GymnasiumConfig, scene: object | None = None) -> DrawnWorlds:
    """Build the simulator of a scenario.

    Raises:
        UsageError: The environment does not exist, or an option does not fit it.
        PluginError: The environment needs a package that is not installed.
    """
    return DrawnWorlds(
        functools.partial(make_world, config),
        dt=config.dt,
        copy=config.copy_by,
        step_timeout=config.step_timeout,
        reuse=config.reuse,
    )


def make_world(config: GymnasiumConfig) -> World:
    """Make one environment with the noise of its scenario."""
    world = GymWorld(config)
    channels: dict[str, Channel] = {}
    if (added := config.noise.observation) is not None:
        channels["observation"] = Channel(len(world.observed), added.scale, added.law)
    if (start := config.noise.initial) is not None:
        channels["initial"] = Channel(state_size(world, start.attribute), start.scale, start.law)
    return Noisy(world, **channels) if channels else world
