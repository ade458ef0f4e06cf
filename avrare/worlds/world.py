"""World: the contract of a simulator that advances one world at a time, and its readout as arrays."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Controller, Floats, Simulator

Copy = Literal["replay", "deepcopy", "hook"]
Columns = tuple[dict[str, Floats], Floats]
"""Signals (N, ...) by name, and observations (N, d)."""


class World(ABC):
    """World that is changed in place.

    Every random choice must be a transform of the noise passed in, and ``reset`` must clear all former
    state. Arrays passed in are read-only. A class without this base class works too.

    Attributes:
        noise_size: Number of standard normal numbers of a reset, and of every step.
        noise_names: Name of each of them, for reports. Default: None, numbered.
        lacks: Reasons by missing capability (``avrare.protocols.System``). Default: none.
        has_table: True: ``numbers`` and ``split_table`` replace ``signals`` and ``observation``, for speed.
            Default: False.
    """

    noise_size: int
    noise_names: Sequence[str] | None = None
    lacks: Mapping[str, str] = {}
    has_table: bool = False

    @abstractmethod
    def reset(self, noise: Floats) -> None:
        """Reset to t = 0, from noise (noise_size,)."""

    @abstractmethod
    def step(self, action: Any, noise: Floats) -> None:
        """Advance by one step; ``action`` is a row of the controller's action, or None without controller."""

    @abstractmethod
    def signals(self) -> Mapping[str, object]:
        """Return numbers (or arrays of fixed shapes) by name, which formulas read; called after each step."""

    def observation(self) -> Any:
        """Return the observation (d,) of the controller. Default: None, the signals in order."""
        return None

    def displace(self, delta: Floats) -> None:
        """Add ``delta`` to the state, after a reset; without it ``Noisy`` refuses ``initial``."""
        raise NotImplementedError

    def snapshot(self) -> object:
        """Return a copy of the state, for ``copy="hook"``."""
        raise NotImplementedError

    def restore(self, snapshot: Any) -> None:
        """Continue from a copy that any world of the same kind has made."""
        raise NotImplementedError

    def assign(self, values: Mapping[str, float]) -> None:
        """Take values of options, by their place, that are drawn for each rollout; called before a reset."""
        raise NotImplementedError

    def close(self) -> None:  # noqa: B027 (its default)
        """Release resources; called once. Default: nothing."""

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """Return the actions of N rows for ``step``, each on its own, from noise (N, noise_size).

        Called before the steps of a batch, for speed. Default: the same actions.
        """
        return actions

    def numbers(self) -> Any:
        """Return K floats; called after each step."""
        raise NotImplementedError

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Return signals (N, ...) by name and observations (N, d) from a table (N, K) of ``numbers``."""
        raise NotImplementedError


class NotDeterministic(UsageError):
    """World that does not depend on its noise alone, where that is required."""


def read_observation(world: World, signals: Mapping[str, Any]) -> object:
    """Return the observation (d,) of ``world``, whose signals are given."""
    observation = world.observation()
    if observation is not None:
        return observation
    return [number for value in signals.values() for number in np.ravel(value).tolist()]


def close(world: World) -> None:
    """Release a world; exceptions are ignored, as it may have broken down already."""
    with contextlib.suppress(Exception):
        world.close()


class ByName:
    """Readout of worlds by the names of their signals."""

    def read_world(self, world: World) -> tuple[Mapping[str, object], object]:
        """Read signals and observation."""
        signals = world.signals()
        return signals, read_observation(world, signals)

    def stack(self, rows: Sequence[Any]) -> Columns:
        """Return the signals and observations of N worlds as arrays."""
        try:
            names = list(rows[0][0])
            if any(len(signals) != len(names) for signals, _ in rows):
                raise KeyError(*names)
            columns = {name: np.array([row[0][name] for row in rows], dtype=np.float64) for name in names}
            return columns, np.array([observation for _, observation in rows], dtype=np.float64)
        except (KeyError, ValueError, TypeError) as error:
            hint = "signals and observation have the same names and shapes in every world, at every step"
            raise UsageError(f"the worlds do not give the same signals: {error!r}", hint) from error


class Table:
    """Readout of K numbers of each world; ``pattern`` names the columns of their table (N, K)."""

    def __init__(self, pattern: World) -> None:
        self.pattern = pattern

    def read_world(self, world: World) -> Any:
        """Read K numbers."""
        return world.numbers()

    def stack(self, rows: Sequence[object]) -> Columns:
        """Join the numbers into a table and name its columns."""
        return self.pattern.split_table(np.array(rows, dtype=np.float64))


Readout = ByName | Table


def choose_readout(pattern: World) -> Readout:
    """Return the readout for worlds like ``pattern``: as a table where they offer it."""
    return Table(pattern) if pattern.has_table else ByName()


class WorldController(Controller):
    """Controller with a world for each rollout: its input is the observation, its output the action.

    Args:
        worlds: Simulator without noise, whose states have ``ego`` (N, d).
    """

    def __init__(self, worlds: Simulator) -> None:
        self.worlds = worlds

    def start(self, n: int) -> Any:
        """Return the worlds at t = 0."""
        return self.worlds.reset(np.empty((n, 0)))

    def act(self, memory: Any, ego: Floats, prediction: object) -> tuple[Floats, Any]:
        """Return the actions (N, d), and the worlds one step later."""
        if not isinstance(ego, np.ndarray):
            raise UsageError(
                f"this controller takes numbers (N, d), not {type(ego).__name__}",
                "a simulator whose state's `ego` is an array, or that has none: then it gets the signals",
            )
        memory = self.worlds.step(memory, ego, np.empty((len(ego), 0)))
        return memory.ego, memory
