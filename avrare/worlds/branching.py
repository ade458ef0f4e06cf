"""Branching: brings a world to the state that another one had."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.base.errors import AvrareError, UsageError
from avrare.protocols import Floats
from avrare.worlds.step_timeout import Watchdog
from avrare.worlds.world import NotDeterministic, Readout, World
from avrare.worlds.world_pool import InputHistory, WorldPool


class Branches:
    """Brings worlds to states along input histories, from the nearest copy or from the start.

    Attributes:
        untested: No copy has been tested yet (``test_copy``).
    """

    def __init__(self, pool: WorldPool, watchdog: Watchdog, readout: Readout) -> None:
        self.pool, self.watchdog, self.readout = pool, watchdog, readout
        self.untested = pool.copying != "replay"

    def branch(self, history: InputHistory, t: int, expected: dict[str, Floats]) -> InputHistory:
        """Return a history of the first ``t`` steps of another, with a world at its end.

        Args:
            history: The other history.
            t: Number of steps.
            expected: Signals at that step, (1, ...) each.

        Raises:
            NotDeterministic: The signals are different now.
            UsageError: The world cannot be copied.
        """
        new = history.branch(t)
        try:
            world = self._advance_to(new, t)
            self._check(world, t, expected)
        except BaseException:
            self.pool.discard(new)
            raise
        if t not in new.copies and (copy := self.pool.snapshot(world)) is not None:
            new.copies[t] = history.copies[t] = copy
        return new

    def _advance_to(self, history: InputHistory, t: int) -> World:
        known = max(history.copies, default=-1)
        if known >= 0:
            world = self.pool.restore(history, history.copies[known])
        else:
            world = self.pool.lend(history)
            self.watchdog.call(world.reset, history.noise[0])
        for step in range(max(known, 0), t):
            self.watchdog.call(world.step, history.actions[step], history.noise[step + 1])
        return world

    def _check(self, world: World, t: int, expected: dict[str, Floats]) -> None:
        found, _ = self.readout.all([self.readout.one(world)])
        if name := _differing_signal(found, expected):
            was, now = expected[name][0], found[name][0]
            raise NotDeterministic(
                f"signal {name!r} was {was} at step {t}, and the same noise gives {now} now: the simulator "
                "does not depend on its noise alone, and no rollout can branch from another",
                "estimate with mc, or derive every random choice from the noise passed to the world",
            )

    def test_copy(self, history: InputHistory, t: int, given: tuple[Any, Floats]) -> None:
        """Check that the first copy of this process continues like the world that it is a copy of.

        Raises:
            UsageError: It does not.
        """
        self.untested = False
        spare = history.branch(t)
        try:
            world: Any = self.pool.restore(spare, spare.copies[t])
            world.step(*given)
            found, _ = self.readout.all([self.readout.one(world)])
            expected, _ = self.readout.all([history.latest])
            name = _differing_signal(found, expected)
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


def _differing_signal(one: dict[str, Floats], other: dict[str, Floats]) -> str:
    return next((name for name in one if not np.array_equal(one[name], other[name])), "")
