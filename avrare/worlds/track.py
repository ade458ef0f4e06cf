"""The way that a world has come: the inputs that bring any world of its kind to the same place.

A row of a batch is a track and a number t: the track's first t steps. Tracks only ever grow, so a row means
the same for ever, whoever else goes on along the same track.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare.worlds.world import World


class Track:
    """Inputs in order, and, in the process where it was made, the world that stands at its end.

    Attributes:
        noise: Of the reset and of every step, (noise_size,) each.
        actions: Of every step.
        world: Stands at the end of the track; None: it has been lent to another, or is in another process.
        latest: What came out of the newest step (``avrare.worlds.readout``); None: unknown.
        fault: What the newest step raised.
        copies: Snapshots by step, of those steps that others have branched from.
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
        """The inputs alone: worlds stay in their process and are driven there again elsewhere."""
        driven = bool(self.actions) and self.actions[0] is not None
        actions: Any = np.stack(self.actions) if driven else len(self.actions)
        return _track, (np.stack(self.noise), actions)

    def was(self, t: int, action: Any, noise: Floats) -> bool:
        """Whether the newest step was this one, from t to t + 1, and it is known what came of it."""
        return (
            len(self.actions) == t + 1
            and (self.latest is not None or self.fault is not None)
            and np.array_equal(self.noise[t + 1], noise)
            and _equal(self.actions[t], action)
        )

    def branch(self, t: int) -> Track:
        """A track of the first ``t`` steps of this one."""
        new = Track(self.noise[: t + 1], self.actions[:t])
        new.copies = {step: copy for step, copy in self.copies.items() if step <= t}
        return new


def _equal(one: Any, two: Any) -> bool:
    if one is None or two is None:
        return one is two
    return bool(np.array_equal(one, two))


def _track(noise: Floats, actions: NDArray[Any] | int) -> Track:
    """What ``Track.__reduce__`` has stored."""
    return Track(list(noise), [None] * actions if isinstance(actions, int) else list(actions))
