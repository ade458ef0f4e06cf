"""Input histories, and the pool of worlds that are lent to them.

A row of a batch is an input history and a number t: the first t steps of the history. Histories only grow, so
the meaning of a row never changes when other rows continue along the same history. A process has as many
worlds as its largest batch has rows.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.world import Copy, World, close


class InputHistory:
    """Inputs in order, and, in the process where it was made, the world at its end.

    Attributes:
        noise: Noise (noise_size,) of the reset and of every step.
        actions: Actions of every step.
        world: World at the end of the history; None: lent to another one, or in another process.
        latest: Readout of the newest step (``avrare.worlds.world``); None: unknown.
        fault: Exception of the newest step, or None.
        copies: Snapshots by step, for steps that others have branched from.
    """

    __slots__ = ("actions", "copies", "fault", "latest", "noise", "world")

    def __init__(self, noise: list[Floats], actions: list[Any]) -> None:
        self.noise = noise
        self.actions = actions
        self.world: World | None = None
        self.latest: Any = None
        self.fault: Exception | None = None
        self.copies: dict[int, Any] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # Only the inputs are pickled: another process replays them.
        has_actions = bool(self.actions) and self.actions[0] is not None
        actions: Any = np.stack(self.actions) if has_actions else len(self.actions)
        return _rebuild_history, (np.stack(self.noise), actions)

    def ended_with(self, t: int, action: Any, noise: Floats) -> bool:
        """Return whether the newest step was this one, from t to t + 1, and its outcome is known."""
        return (
            len(self.actions) == t + 1
            and (self.latest is not None or self.fault is not None)
            and np.array_equal(self.noise[t + 1], noise)
            and np.array_equal(self.actions[t], action)
        )

    def branch(self, t: int) -> InputHistory:
        """Return a history of the first ``t`` steps of this one."""
        new = InputHistory(self.noise[: t + 1], self.actions[:t])
        new.copies = {step: copy for step, copy in self.copies.items() if step <= t}
        return new


def _rebuild_history(noise: Floats, actions: NDArray[Any] | int) -> InputHistory:
    return InputHistory(list(noise), [None] * actions if isinstance(actions, int) else list(actions))


class WorldPool:
    """Pool that creates worlds and lends them to input histories.

    Args:
        make: Creates a world.
        copying: Way of copying a world.
        reuse: Reset a world for another rollout; else every rollout gets a new one.
    """

    def __init__(self, make: Callable[[], World], copying: Copy, reuse: bool) -> None:
        self.make, self.copying, self.reuse = make, copying, reuse
        self._idle: list[World] = []
        self._lent: dict[InputHistory, None] = {}

    def recall(self, count: int, keep: Collection[InputHistory]) -> None:
        """Take back worlds from histories other than ``keep`` until ``count`` are idle or none is left."""
        missing = count - len(self._idle)
        if missing <= 0:
            return
        for history in [history for history in self._lent if history not in keep][:missing]:
            del self._lent[history]
            world, history.world = history.world, None
            if world is not None:
                self.put_away(world)

    def lend(self, history: InputHistory) -> World:
        """Lend a world in an arbitrary state."""
        history.world = self._idle.pop() if self._idle else self.make()
        self._lent[history] = None
        return history.world

    def discard(self, history: InputHistory) -> None:
        """Discard the world of a history: it has broken down."""
        self._lent.pop(history, None)
        world, history.world = history.world, None
        if world is not None:
            close(world)

    def snapshot(self, world: World) -> Any:
        """Copy the state of ``world``; None where copies are made by replay.

        Raises:
            UsageError: The world cannot be copied in this way.
        """
        if self.copying == "replay":
            return None
        try:
            return copy.deepcopy(world) if self.copying == "deepcopy" else world.snapshot()  # type: ignore[attr-defined]
        except Exception as error:
            raise UsageError(
                f"the world cannot be copied by {self.copying}: {type(error).__name__}: {error}",
                "copy: replay needs only that the same noise gives the same rollout",
            ) from error

    def restore(self, history: InputHistory, snapshot: Any) -> World:
        """Lend a world in the state of a snapshot."""
        if self.copying == "hook":
            world: Any = self.lend(history)
            world.restore(snapshot)
            return world  # type: ignore[no-any-return]
        if self._idle:
            close(self._idle.pop())  # the copy replaces it
        history.world = copy.deepcopy(snapshot)
        self._lent[history] = None
        return history.world

    def put_away(self, world: World) -> None:
        """Return a world to the pool."""
        if self.reuse:
            self._idle.append(world)
        else:
            close(world)
