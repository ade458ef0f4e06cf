"""A world with noise on what goes in and what is seen of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds.channel import Channel
from avrare.worlds.world import World, close, observed


class Noisy:
    """A world whose actions, observations or initial state are disturbed; its signals stay the true ones.

    A row of its noise holds the world's own numbers, then those of the channels in the order of the
    arguments. The initial state is displaced after the reset, with the numbers of row 0.

    Args:
        world: The world.
        action: Added to every action.
        observation: Added to what the controller sees.
        initial: Handed to the world's ``displace``.

    Raises:
        UsageError: The world has no ``displace``.
    """

    def __init__(
        self,
        world: World,
        *,
        action: Channel | None = None,
        observation: Channel | None = None,
        initial: Channel | None = None,
    ) -> None:
        if initial is not None and not hasattr(world, "displace"):
            raise UsageError(f"{type(world).__name__} has no displace(delta) to change its initial state")
        self.world, self.action, self.shown, self.start = world, action, observation, initial
        self._begin: list[int] = [int(world.noise_size)]
        for channel in (action, observation, initial):
            self._begin.append(self._begin[-1] + (channel.size if channel is not None else 0))
        self.noise_size = self._begin[-1]
        self._error: Any = 0.0
        self.lacks: Mapping[str, str] = getattr(world, "lacks", {})
        if hasattr(world, "snapshot") and hasattr(world, "restore"):
            self.snapshot, self.restore = self._snapshot, self._restore

    def reset(self, noise: Floats) -> None:
        """Go to t = 0, from noise (noise_size,)."""
        self.world.reset(noise[: self._begin[0]])
        if self.start is not None:
            self.world.displace(self.start(noise[self._begin[2] :]))  # type: ignore[attr-defined]
        self._see(noise)

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """The disturbed actions of N worlds.

        Raises:
            UsageError: There is no action to disturb, or it has another size.
        """
        if self.action is not None:
            size = 0 if actions is None else np.size(actions) // len(noise)
            if size != self.action.size:
                raise UsageError(f"noise on {self.action.size} numbers of an action, which has {size}")
            delta = self.action(noise[:, self._begin[0] : self._begin[1]])
            actions = actions + np.reshape(delta, np.shape(actions))
        further = getattr(self.world, "prepare", None)
        return actions if further is None else further(actions, noise[:, : self._begin[0]])

    def step(self, action: Any, noise: Floats) -> None:
        """Go one step on with a prepared action."""
        self.world.step(action, noise[: self._begin[0]])
        self._see(noise)

    def signals(self) -> Mapping[str, Any]:
        """The world's own."""
        return self.world.signals()

    def observation(self) -> Any:
        """(d,) what the controller sees."""
        seen = observed(self.world, self.world.signals())
        return seen if self.shown is None else np.asarray(seen) + self._error

    def close(self) -> None:
        """Let the world go."""
        close(self.world)

    def _see(self, noise: Floats) -> None:
        if self.shown is not None:
            self._error = self.shown(noise[self._begin[1] : self._begin[2]])

    def _snapshot(self) -> Any:
        return self.world.snapshot(), self._error  # type: ignore[attr-defined]

    def _restore(self, snapshot: Any) -> None:
        inner, self._error = snapshot
        self.world.restore(inner)  # type: ignore[attr-defined]
