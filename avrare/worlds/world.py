"""What a simulator offers that knows one world at a time, and what goes wrong with one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats

Copy = Literal["replay", "deepcopy", "hook"]


class World(Protocol):
    """One world, changed in place.

    All that is random in it is a transform of the noise that it is handed. After ``reset`` nothing of what
    was before may show. What it is handed cannot be written to.

    Optional: ``observation() -> (d,)``, what the controller sees (by default the signals in order);
    ``displace(delta)``, which moves the state after a reset; ``snapshot() -> Any`` and ``restore(snapshot)``,
    with which any world of the same kind goes on where this one stood; ``close()``; ``lacks``, a mapping of
    what it cannot do (``avrare.worlds.capabilities``) to the reason.

    For speed: ``prepare(actions, noise)``, which turns the actions of N rows into those that ``step`` is
    handed, from noise (N, noise_size), each row on its own; ``numbers() -> K floats`` with
    ``named(table) -> (signals, observations)``, which are read in place of ``signals`` and ``observation``.

    Attributes:
        noise_size: Standard normal numbers of a reset, and of every step.
    """

    noise_size: int

    def reset(self, noise: Floats) -> None:
        """Go to t = 0, from noise (noise_size,)."""

    def step(self, action: Any, noise: Floats) -> None:
        """Go one step on; ``action`` is a row of what the controller gives, or None without one."""

    def signals(self) -> Mapping[str, Any]:
        """Numbers (or arrays of fixed shapes) by name: what formulas read."""


class NotDeterministic(UsageError):
    """A world that does not depend on its noise alone, where that is needed."""


def observed(world: World, signals: Mapping[str, Any]) -> Any:
    """(d,) what the controller sees of ``world``, whose signals are known."""
    observation = getattr(world, "observation", None)
    if observation is not None:
        return observation()
    return [number for value in signals.values() for number in np.ravel(value).tolist()]


def close(world: World) -> None:
    """Let a world go; what it says to that does not matter any more."""
    end = getattr(world, "close", None)
    try:
        if end is not None:
            end()
    except Exception:  # it may have broken down already
        return
