"""The worlds of one process: as many as the largest batch has rows, lent to one track after another."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection
from typing import Any

from avrare.errors import UsageError
from avrare.worlds.track import Track
from avrare.worlds.world import Copy, World, close


class Fleet:
    """Makes worlds, lends them to tracks, takes them back.

    Args:
        make: Makes a world.
        copying: How a world is copied.
        reuse: Whether a world is reset for another rollout; else every rollout gets a new one.
    """

    def __init__(self, make: Callable[[], World], copying: Copy, reuse: bool) -> None:
        self.make, self.copying, self.reuse = make, copying, reuse
        self._idle: list[World] = []
        self._lent: dict[Track, None] = {}

    def recall(self, count: int, keep: Collection[Track]) -> None:
        """Take worlds back until ``count`` are idle, as far as tracks other than ``keep`` have any."""
        missing = count - len(self._idle)
        if missing <= 0:
            return
        for track in [track for track in self._lent if track not in keep][:missing]:
            del self._lent[track]
            world, track.world = track.world, None
            if world is not None:
                self.put_away(world)

    def lend(self, track: Track) -> World:
        """A world for ``track``, in no particular state."""
        track.world = self._idle.pop() if self._idle else self.make()
        self._lent[track] = None
        return track.world

    def scrap(self, track: Track) -> None:
        """Throw the world of ``track`` away: it has broken down."""
        self._lent.pop(track, None)
        world, track.world = track.world, None
        if world is not None:
            close(world)

    def snapshot(self, world: World) -> Any:
        """A copy of where ``world`` stands; None where copies are made by replay.

        Raises:
            UsageError: It cannot be copied in the way that was asked for.
        """
        if self.copying == "replay":
            return None
        try:
            return copy.deepcopy(world) if self.copying == "deepcopy" else world.snapshot()  # type: ignore[attr-defined]
        except Exception as error:
            raise UsageError(
                f"the world cannot be copied by {self.copying}: {type(error).__name__}: {error}",
                "copy: replay needs nothing of it but that the same noise gives the same run",
            ) from error

    def restore(self, track: Track, snapshot: Any) -> World:
        """A world for ``track`` that stands where the snapshot was taken."""
        if self.copying == "hook":
            world: Any = self.lend(track)
            world.restore(snapshot)
            return world  # type: ignore[no-any-return]
        if self._idle:
            close(self._idle.pop())  # its place is taken by the copy
        track.world = copy.deepcopy(snapshot)
        self._lent[track] = None
        return track.world

    def put_away(self, world: World) -> None:
        """Keep a world for another rollout."""
        if self.reuse:
            self._idle.append(world)
        else:
            close(world)
