"""From what each of N worlds gives to arrays of all: by name, or as a table where worlds offer that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.world import World, observed

_HINT = "signals and observation have the same names and shapes in every world, at every step"
Columns = tuple[dict[str, Floats], Floats]
"""Signals (N, ...) by name, and what the controllers see (N, d)."""


class Readout(Protocol):
    """What is read off one world, and off all."""

    def one(self, world: Any) -> Any:
        """What one world gives."""

    def all(self, rows: Sequence[Any]) -> Columns:
        """What ``one`` gave for each of N worlds, as arrays.

        Raises:
            UsageError: They do not go together.
        """


def readout(pattern: Any) -> Readout:
    """The way for worlds like ``pattern``: the quick one where they have ``numbers`` and ``named``."""
    return Table(pattern) if hasattr(pattern, "numbers") and hasattr(pattern, "named") else ByName()


class ByName:
    """Signals and observation of each world."""

    def one(self, world: World) -> Any:
        """Signals and observation."""
        signals = world.signals()
        return signals, observed(world, signals)

    def all(self, rows: Sequence[Any]) -> Columns:
        """One array for each signal."""
        try:
            names = list(rows[0][0])
            if any(len(signals) != len(names) for signals, _ in rows):
                raise KeyError(*names)
            columns = {name: np.array([row[0][name] for row in rows], dtype=np.float64) for name in names}
            return columns, np.array([seen for _, seen in rows], dtype=np.float64)
        except (KeyError, ValueError, TypeError) as error:
            raise UsageError(f"the worlds do not give the same signals: {error!r}", _HINT) from error


class Table:
    """K numbers of each world, which one world can name for all.

    Args:
        pattern: A world with ``numbers() -> K floats`` and ``named(table) -> Columns``, where ``table`` is
            (N, K) and nothing but the world's making decides how.
    """

    def __init__(self, pattern: Any) -> None:
        self.pattern = pattern

    def one(self, world: Any) -> Any:
        """K numbers."""
        return world.numbers()

    def all(self, rows: Sequence[Any]) -> Columns:
        """The columns of the table, named."""
        return self.pattern.named(np.array(rows, dtype=np.float64))  # type: ignore[no-any-return]
