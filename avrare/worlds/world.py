"""World: the protocol of a simulator that advances one world at a time, and its readout as arrays."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats, find_ability

Copy = Literal["replay", "deepcopy", "hook"]
_HINT = "signals and observation have the same names and shapes in every world, at every step"
Columns = tuple[dict[str, Floats], Floats]
"""Signals (N, ...) by name, and observations (N, d)."""


class World(Protocol):
    """World that is changed in place.

    Every random choice must be a transform of the noise passed in, and ``reset`` must clear all former
    state. Arrays passed in are read-only. Optional: ``ObservesWorld``, ``CanBeDisplaced``,
    ``CanBeCopied``, ``CanBeClosed``, ``avrare.protocols.HasLimits``; for speed ``PreparesActions`` and
    ``ReadsAsTable``.

    Attributes:
        noise_size: Number of standard normal numbers of a reset, and of every step.
    """

    noise_size: int

    def reset(self, noise: Floats) -> None:
        """Reset to t = 0, from noise (noise_size,)."""

    def step(self, action: Any, noise: Floats) -> None:
        """Advance by one step; ``action`` is a row of the controller's action, or None without controller."""

    def signals(self) -> Mapping[str, Any]:
        """Return numbers (or arrays of fixed shapes) by name, which formulas read."""


class ObservesWorld(Protocol):
    """World with an observation for the controller; by default it observes the signals in order."""

    def observation(self) -> Any:
        """Return the observation (d,)."""


class CanBeDisplaced(Protocol):
    """World whose state can be moved after a reset."""

    def displace(self, delta: Floats) -> None:
        """Add ``delta`` to the state."""


class CanBeCopied(Protocol):
    """World with copies of its own making."""

    def snapshot(self) -> Any:
        """Return a copy of the state."""

    def restore(self, snapshot: Any) -> None:
        """Continue from a copy that any world of the same kind has made."""


class TakesValues(Protocol):
    """World with numbers that may differ from rollout to rollout."""

    def assign(self, values: Mapping[str, float], /) -> None:
        """Take values of options, by their place; called before every reset."""


class CanBeClosed(Protocol):
    """World that holds resources."""

    def close(self) -> None:
        """Release the resources."""


class PreparesActions(Protocol):
    """World that turns the actions of a batch into those of its ``step``, each row on its own."""

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """Return the actions of N rows for ``step``, from noise (N, noise_size)."""


class ReadsAsTable(Protocol):
    """World that is read as K numbers instead of by ``signals`` and ``observation``."""

    def numbers(self) -> Any:
        """Return K floats."""

    def named(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Return signals (N, ...) by name and observations (N, d) from a table (N, K)."""


class NotDeterministic(UsageError):
    """World that does not depend on its noise alone, where that is required."""


def observed(world: World, signals: Mapping[str, Any]) -> Any:
    """Return the observation (d,) of ``world``, whose signals are given."""
    observing = find_ability(world, ObservesWorld)
    if observing is not None:
        return observing.observation()
    return [number for value in signals.values() for number in np.ravel(value).tolist()]


def close(world: World) -> None:
    """Release a world; exceptions are ignored, as it may have broken down already."""
    closing = find_ability(world, CanBeClosed)
    if closing is not None:
        with contextlib.suppress(Exception):
            closing.close()


class ByName:
    """Readout of worlds by the names of their signals."""

    def one(self, world: World) -> Any:
        """Read signals and observation."""
        signals = world.signals()
        return signals, observed(world, signals)

    def all(self, rows: Sequence[Any]) -> Columns:
        """Return the signals and observations of N worlds as arrays."""
        try:
            names = list(rows[0][0])
            if any(len(signals) != len(names) for signals, _ in rows):
                raise KeyError(*names)
            columns = {name: np.array([row[0][name] for row in rows], dtype=np.float64) for name in names}
            return columns, np.array([seen for _, seen in rows], dtype=np.float64)
        except (KeyError, ValueError, TypeError) as error:
            raise UsageError(f"the worlds do not give the same signals: {error!r}", _HINT) from error


class Table:
    """Readout of K numbers of each world; ``pattern`` names the columns of their table (N, K)."""

    def __init__(self, pattern: ReadsAsTable) -> None:
        self.pattern = pattern

    def one(self, world: Any) -> Any:
        """Read K numbers."""
        return world.numbers()

    def all(self, rows: Sequence[Any]) -> Columns:
        """Join the numbers into a table and name its columns."""
        return self.pattern.named(np.array(rows, dtype=np.float64))


Readout = ByName | Table


def choose_readout(pattern: Any) -> Readout:
    """Return the readout for worlds like ``pattern``: as a table where they offer it."""
    table = find_ability(pattern, ReadsAsTable)
    return ByName() if table is None else Table(table)
