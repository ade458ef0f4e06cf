"""Worlds and a controller as a system, for ``avrare.Problem``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from avrare.protocols import Floats, Signals
from avrare.worlds.simulator import Worlds, WorldState
from avrare.worlds.world import Copy, World


@dataclass(frozen=True)
class LoopState:
    """Worlds, and what their controller remembers."""

    world: WorldState
    memory: Any


class WorldSystem:
    """A system (``avrare.protocols.System``) of worlds under an optional controller.

    Args:
        worlds: The simulator.
        controller: ``start(n) -> memory`` and ``act(memory, seen, None) -> (action, memory)``, where ``seen``
            is (N, d) and ``action`` has leading axis N; None: the worlds are handed None.
    """

    def __init__(self, worlds: Worlds, controller: Any = None) -> None:
        self.worlds, self.controller = worlds, controller
        self.noise_size = worlds.noise_size

    def initial(self, noise: Floats) -> LoopState:
        """State at t = 0 from noise (N, noise_size)."""
        memory = self.controller.start(len(noise)) if self.controller is not None else None
        return LoopState(self.worlds.reset(noise), memory)

    def step(self, state: LoopState, noise: Floats) -> LoopState:
        """State one step later."""
        action, memory = None, None
        if self.controller is not None:
            action, memory = self.controller.act(state.memory, state.world.seen, None)
        return LoopState(self.worlds.step(state.world, action, noise), memory)

    def signals(self, state: LoopState) -> Signals:
        """Of the worlds."""
        return self.worlds.signals(state.world)

    def counts(self, state: LoopState) -> dict[str, NDArray[Any]]:
        """Of the worlds, and of a controller that has some."""
        own = getattr(self.controller, "counts", None)
        return self.worlds.counts(state.world) | (own(state.memory) if own is not None else {})


def as_system(
    make: Callable[[], World],
    controller: Any = None,
    *,
    copy: Copy = "replay",
    step_timeout: float | None = None,
    reuse: bool = True,
) -> WorldSystem:
    """The system of worlds that ``make`` makes; see ``Worlds`` and ``WorldSystem``.

    Raises:
        UsageError: An argument does not fit.
    """
    return WorldSystem(Worlds(make, copy=copy, step_timeout=step_timeout, reuse=reuse), controller)
