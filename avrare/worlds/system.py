"""System of worlds and a controller, for ``avrare.Problem``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from avrare.protocols import CountsEvents, Floats, Signals, find_ability
from avrare.worlds.simulator import Worlds, WorldState
from avrare.worlds.world import Copy, World


@dataclass(frozen=True)
class LoopState:
    """State of the worlds and memory of their controller."""

    world: WorldState
    memory: Any


class WorldSystem:
    """System (``avrare.protocols.System``) of worlds under an optional controller.

    Args:
        worlds: Simulator.
        controller: ``start(n) -> memory`` and ``act(memory, seen, None) -> (action, memory)``, where ``seen``
            is (N, d) and ``action`` has leading axis N; None: the worlds get the action None.
    """

    def __init__(self, worlds: Worlds, controller: Any = None) -> None:
        self.worlds = self.simulator = worlds
        self.controller = controller
        self.noise_size = worlds.noise_size

    def initial(self, noise: Floats) -> LoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        memory = self.controller.start(len(noise)) if self.controller is not None else None
        return LoopState(self.worlds.reset(noise), memory)

    def step(self, state: LoopState, noise: Floats) -> LoopState:
        """Return the state one step later."""
        action, memory = None, None
        if self.controller is not None:
            action, memory = self.controller.act(state.memory, state.world.seen, None)
        return LoopState(self.worlds.step(state.world, action, noise), memory)

    def signals(self, state: LoopState) -> Signals:
        """Return the signals of the worlds."""
        return self.worlds.signals(state.world)

    def counts(self, state: LoopState) -> dict[str, NDArray[Any]]:
        """Return the counters of the worlds and of the controller."""
        counting = find_ability(self.controller, CountsEvents)
        own = counting.counts(state.memory) if counting is not None else {}
        return {**self.worlds.counts(state.world), **own}


def as_system(
    make: Callable[[], World],
    controller: Any = None,
    *,
    copy: Copy = "replay",
    step_timeout: float | None = None,
    reuse: bool = True,
) -> WorldSystem:
    """Return the system of worlds that ``make`` creates; see ``Worlds`` and ``WorldSystem``.

    Raises:
        UsageError: An argument is invalid.
    """
    return WorldSystem(Worlds(make, copy=copy, step_timeout=step_timeout, reuse=reuse), controller)
