"""Worlds some of whose numbers are drawn for each rollout, which they take at the reset.

The drawn values travel at the end of the rows of noise, as zeros after the reset: so they are part of the
inputs from which a world is replayed, and a world in another process gets the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from avrare.protocols import Floats, adapt
from avrare.worlds.world import World, close
from avrare.worlds.worlds_simulator import Worlds, WorldState


class DrawnWorlds(Worlds):
    """Simulator of worlds that take values (``World.assign``) in place of drawn options.

    Args:
        make: Creates a world.
        names: Places of the options that are drawn, in the order of their numbers.
        options: As of ``Worlds``.
    """

    def __init__(self, make: Callable[[], World], names: Sequence[str] = (), **options: Any) -> None:
        super().__init__(partial(_Valued, make, tuple(names)) if names else make, **options)
        self._plain, self._names = (make, options), tuple(names)
        self.noise_size -= len(self._names)
        if self.noise_names is not None:
            self.noise_names = self.noise_names[: self.noise_size]

    def __reduce__(self) -> tuple[object, ...]:
        make, options = self._plain
        return partial(type(self), make, self._names, **options), ()

    def drawing(self, laws: Mapping[str, object]) -> DrawnWorlds:
        """Return the same simulator for draws of options by these laws."""
        make, options = self._plain
        return type(self)(make, tuple(laws), **options)

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> WorldState:
        """Return the worlds at t = 0 with drawn values (N,)."""
        return super().reset(np.column_stack([noise, *(values[name] for name in self._names)]))

    def step(self, world: WorldState, action: object, noise: Floats) -> WorldState:
        """Return worlds one step later; ``action`` is an array with leading axis N, or None."""
        return super().step(world, action, np.pad(noise, ((0, 0), (0, len(self._names)))))


class _Valued(World):
    # World whose rows of noise end with the values of its options.

    def __init__(self, make: Callable[[], World], names: tuple[str, ...]) -> None:
        self.world, self._names = adapt(World, make()), names
        self._own = int(self.world.noise_size)
        self.noise_size = self._own + len(names)
        if self.world.noise_names is not None:
            self.noise_names = (*self.world.noise_names, *names)
        self.lacks, self.has_table = self.world.lacks, self.world.has_table

    def reset(self, noise: Floats) -> None:
        self.world.assign(dict(zip(self._names, noise[self._own :].tolist(), strict=True)))
        self.world.reset(noise[: self._own])

    def prepare(self, actions: object, noise: Floats) -> Any:
        return self.world.prepare(actions, noise[:, : self._own])

    def step(self, action: object, noise: Floats) -> None:
        self.world.step(action, noise[: self._own])

    def signals(self) -> Mapping[str, object]:
        return self.world.signals()

    def observation(self) -> Any:
        return self.world.observation()

    def numbers(self) -> Any:
        return self.world.numbers()

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        return self.world.split_table(table)

    def snapshot(self) -> object:
        return self.world.snapshot()

    def restore(self, snapshot: object) -> None:
        self.world.restore(snapshot)

    def close(self) -> None:
        close(self.world)
