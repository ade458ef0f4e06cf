"""Rollouts that branch from others: worlds are brought to where another one was."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.errors import AvrareError, UsageError
from avrare.protocols import Floats
from avrare.worlds.fleet import Fleet
from avrare.worlds.readout import Readout
from avrare.worlds.timeout import Watch
from avrare.worlds.track import Track
from avrare.worlds.world import NotDeterministic, World


class Branches:
    """Brings worlds to places on tracks, from the nearest copy or from the start.

    Attributes:
        untried: There is no copy yet that has been seen to go on as it should.
    """

    def __init__(self, fleet: Fleet, watch: Watch, readout: Readout) -> None:
        self.fleet, self.watch, self.readout = fleet, watch, readout
        self.untried = fleet.copying != "replay"

    def brought(self, track: Track, t: int, expected: dict[str, Floats]) -> Track:
        """A track of the first ``t`` steps of another, with a world at its end.

        Args:
            track: The other.
            t: Steps.
            expected: The signals that there were, (1, ...) each.

        Raises:
            NotDeterministic: There are others now.
            UsageError: The world cannot be copied.
        """
        new = track.branch(t)
        try:
            world = self._driven(new, t)
            self._check(world, t, expected)
        except BaseException:
            self.fleet.scrap(new)
            raise
        if t not in new.copies and (copy := self.fleet.snapshot(world)) is not None:
            new.copies[t] = track.copies[t] = copy
        return new

    def _driven(self, track: Track, t: int) -> World:
        """A world for ``track``, at its end after ``t`` steps."""
        known = max(track.copies, default=-1)
        if known >= 0:
            world = self.fleet.restore(track, track.copies[known])
        else:
            world = self.fleet.lend(track)
            self.watch.call(world.reset, track.noise[0])
        for step in range(max(known, 0), t):
            self.watch.call(world.step, track.actions[step], track.noise[step + 1])
        return world

    def _check(self, world: World, t: int, expected: dict[str, Floats]) -> None:
        found, _ = self.readout.all([self.readout.one(world)])
        if name := _different(found, expected):
            was, now = expected[name][0], found[name][0]
            raise NotDeterministic(
                f"signal {name!r} was {was} at step {t}, and the same noise gives {now} now: the simulator "
                "does not depend on its noise alone, and no rollout can branch from another",
                "estimate with mc, or draw all that is random in it from the noise it is handed",
            )

    def try_copy(self, track: Track, t: int, given: tuple[Any, Floats]) -> None:
        """Whether the first copy of this process goes on as what it is a copy of: not all can be told apart.

        Raises:
            UsageError: It does not.
        """
        self.untried = False
        spare = track.branch(t)
        try:
            world: Any = self.fleet.restore(spare, spare.copies[t])
            world.step(*given)
            found, _ = self.readout.all([self.readout.one(world)])
            expected, _ = self.readout.all([track.latest])
            name = _different(found, expected)
            reason = f"signal {name!r} differs after a step" if name else ""
        except AvrareError:
            raise
        except Exception as error:
            reason = f"it raises {type(error).__name__}: {error}"
        finally:
            self.fleet.scrap(spare)
        if reason:
            raise UsageError(
                f"a copy of the world by {self.fleet.copying} does not go on as the world does: {reason}",
                "copy: replay needs nothing of it but that the same noise gives the same run",
            )


def _different(one: dict[str, Floats], other: dict[str, Floats]) -> str:
    """A signal that is not the same in both, empty where all are."""
    return next((name for name in one if not np.array_equal(one[name], other[name])), "")
