"""Input histories, the pool of worlds that are lent to them, and branches of histories.

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

from avrare.base.errors import AvrareError, UsageError
from avrare.protocols import Floats, adapt
from avrare.worlds.step_timeout import Watchdog
from avrare.worlds.world import Copy, NotDeterministic, Readout, World, close


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

    def __reduce__(self) -> tuple[object, ...]:
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
        new.copies = {step: snapshot for step, snapshot in self.copies.items() if step <= t}
        return new


def _rebuild_history(noise: Floats, actions: NDArray[Any] | int) -> InputHistory:
    return InputHistory(list(noise), [None] * actions if isinstance(actions, int) else list(actions))


class WorldPool:
    """Pool that creates worlds and lends them to input histories; without ``reuse`` each is lent once."""

    def __init__(self, make: Callable[[], object], copying: Copy, reuse: bool) -> None:
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
                self.return_world(world)

    def take_world(self, history: InputHistory) -> World:
        """Lend a world in an arbitrary state."""
        history.world = self._idle.pop() if self._idle else adapt(World, self.make())
        self._lent[history] = None
        return history.world

    def discard(self, history: InputHistory) -> None:
        """Discard the world of a history: it has broken down."""
        self._lent.pop(history, None)
        world, history.world = history.world, None
        if world is not None:
            close(world)

    def snapshot(self, world: World) -> object:
        """Copy the state of ``world``; None where copies are made by replay."""
        if self.copying == "replay":
            return None
        try:
            return copy.deepcopy(world) if self.copying == "deepcopy" else world.snapshot()
        except Exception as error:
            raise UsageError(
                f"the world cannot be copied by {self.copying}: {type(error).__name__}: {error}",
                "copy: replay needs only that the same noise gives the same rollout",
            ) from error

    def restore(self, history: InputHistory, snapshot: Any) -> World:
        """Lend a world in the state of a snapshot."""
        if self.copying == "hook":
            world = self.take_world(history)
            world.restore(snapshot)
            return world
        if self._idle:
            close(self._idle.pop())  # the copy replaces it
        history.world = copy.deepcopy(snapshot)
        self._lent[history] = None
        return history.world

    def return_world(self, world: World) -> None:
        """Return a world to the pool."""
        if self.reuse:
            self._idle.append(world)
        else:
            close(world)


class Branches:
    """Brings worlds to states along input histories, from the nearest copy or from the start.

    Attributes:
        untested: No copy has been tested yet (``test_copy``).
    """

    def __init__(self, pool: WorldPool, watchdog: Watchdog, readout: Readout) -> None:
        self.pool, self.watchdog, self.readout = pool, watchdog, readout
        self.untested = pool.copying != "replay"

    def branch(self, history: InputHistory, t: int, expected: dict[str, Floats]) -> InputHistory:
        """Return a history of the first ``t`` steps, with a world that must have the ``expected`` signals."""
        new = history.branch(t)
        try:
            world = self._advance_to(new, t)
            self._check(world, t, expected)
        except BaseException:
            self.pool.discard(new)
            raise
        if t not in new.copies and (snapshot := self.pool.snapshot(world)) is not None:
            new.copies[t] = history.copies[t] = snapshot
        return new

    def _advance_to(self, history: InputHistory, t: int) -> World:
        nearest = max(history.copies, default=-1)
        if nearest >= 0:
            world = self.pool.restore(history, history.copies[nearest])
        else:
            world = self.pool.take_world(history)
            self.watchdog.call(world.reset, history.noise[0])
        for step in range(max(nearest, 0), t):
            self.watchdog.call(world.step, history.actions[step], history.noise[step + 1])
        return world

    def _check(self, world: World, t: int, expected: dict[str, Floats]) -> None:
        again, _ = self.readout.stack([self.readout.read_world(world)])
        if name := _differing_signal(again, expected):
            was, now = expected[name][0], again[name][0]
            raise NotDeterministic(
                f"signal {name!r} was {was} at step {t}, and the same noise gives {now} now: the simulator "
                "does not depend on its noise alone, and no rollout can branch from another",
                "estimate with mc, or derive every random choice from the noise passed to the world",
            )

    def test_copy(self, history: InputHistory, t: int, given: tuple[object, Floats]) -> None:
        """Check that the first copied world of this process continues like its original."""
        self.untested = False
        spare = history.branch(t)
        try:
            world: Any = self.pool.restore(spare, spare.copies[t])
            world.step(*given)
            copied, _ = self.readout.stack([self.readout.read_world(world)])
            expected, _ = self.readout.stack([history.latest])
            name = _differing_signal(copied, expected)
            reason = f"signal {name!r} differs after a step" if name else ""
        except AvrareError:
            raise
        except Exception as error:
            reason = f"it raises {type(error).__name__}: {error}"
        finally:
            self.pool.discard(spare)
        if reason:
            raise UsageError(
                f"a copy of the world by {self.pool.copying} does not continue like the world: {reason}",
                "copy: replay needs only that the same noise gives the same rollout",
            )


def _differing_signal(first: dict[str, Floats], second: dict[str, Floats]) -> str:
    return next((name for name in first if not np.array_equal(first[name], second[name])), "")
