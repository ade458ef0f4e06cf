"""Controller whose memory is the state of a world."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Controller, Floats, Simulator


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
