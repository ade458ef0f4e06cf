"""Population of splitting: R x N slots in one set of arrays, with the noise and the carries of each.

The arrays belong to the estimator and are written in place: a stage touches only the rows it replaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.protocols import Bools, Floats
from avrare.rollout.request import FROM_START, Carry, Integers, Past, Rollouts

_NEVER = np.iinfo(np.int64).max
_BLOCK = 2**18
"""Scores that are written at once."""


@dataclass(frozen=True)
class TapeAddresses:
    """Addresses of the noise of F rollouts, enough to draw it again.

    Attributes:
        run: (F, 1).
        stage: (F, T + 1) as in ``Population``.
        particle: (F, T + 1) as in ``Population``.
        robustness: (F,) of the rollouts.
        root: (F,) slot of the first ancestor.
    """

    run: Integers
    stage: NDArray[np.int32]
    particle: NDArray[np.int32]
    robustness: Floats
    root: Integers


@dataclass(frozen=True)
class Population:
    """Slots of all runs; slot r * N + i is particle i of run r, T is the number of steps.

    Attributes:
        scores: (R N, T + 1) running score.
        violated: (R N,) the rollout violates the specification.
        error: (R N,) the rollout broke down.
        robustness: (R N,) of the rollout.
        root: (R N,) slot of the first ancestor.
        stage: (R N, T + 1) stage that drew the noise of each step.
        particle: (R N, T + 1) particle that the noise of each step was drawn for.
        since: (R N,) step from which on the history holds the slot's carries.
        history: Carries of all slots at each step whose carries are stored.
    """

    scores: Floats
    violated: Bools
    error: Bools
    robustness: Floats
    root: Integers
    stage: NDArray[np.int32]
    particle: NDArray[np.int32]
    since: Integers
    history: dict[int, Carry] = field(default_factory=dict)

    @staticmethod
    def empty(slots: int, particles: int, steps: int) -> Population:
        """Return the slots before the first rollout."""
        shape = (slots, steps + 1)
        number = np.arange(slots) % particles
        return Population(
            scores=np.full(shape, -np.inf),
            violated=np.zeros(slots, dtype=bool),
            error=np.zeros(slots, dtype=bool),
            robustness=np.full(slots, np.inf),
            root=np.arange(slots),
            stage=np.zeros(shape, dtype=np.int32),
            particle=np.repeat(number[:, None], steps + 1, axis=1).astype(np.int32),
            since=np.full(slots, _NEVER),
        )

    @property
    def final(self) -> Floats:
        """(R N,) score of the complete rollout."""
        return self.scores[:, -1]

    def addresses(self, slots: Integers, particles: int, first_run: int) -> TapeAddresses:
        """Return the addresses of the tapes of ``slots``."""
        run = slots[:, None] // particles + first_run
        robustness, root = self.robustness[slots], self.root[slots]
        return TapeAddresses(run, self.stage[slots], self.particle[slots], robustness, root)

    def store(self, slots: Integers, start: Integers, outcome: Rollouts) -> None:
        """Write the rollouts of ``slots``, which branched at ``start`` (-1: at the beginning)."""
        steps = np.arange(self.scores.shape[1])
        size = max(1, _BLOCK // len(steps))
        for begin in range(0, len(slots), size):
            block = slice(begin, begin + size)
            old = self.scores[slots[block]]
            self.scores[slots[block]] = np.where(steps > start[block, None], outcome.scores[block], old)
        self.violated[slots] = outcome.violated[:, 0]
        self.error[slots] = outcome.error
        self.robustness[slots] = outcome.robustness[:, 0]
        given = np.zeros(len(slots), dtype=bool)
        for t, rows, carry in outcome.carries:
            given[rows] = True
            self.store_carry(t, slots[rows], carry)
        self.since[slots[~given]] = _NEVER

    def inherit(
        self,
        children: Integers,
        parents: Integers,
        start: Integers,
        stage: Integers,
        number: Integers,
        every: int = 1,
    ) -> None:
        """Give ``children`` the past of ``parents`` up to and including ``start``, new noise after it.

        Where only some carries are stored, the newest before ``start`` is handed on.
        """
        past = np.arange(self.scores.shape[1]) <= start[:, None]
        self.root[children] = self.root[parents]
        for table, fresh in ((self.stage, stage), (self.particle, number)):
            table[children] = np.where(past, table[parents], fresh[:, None])
        self.scores[children] = np.where(past, self.scores[parents], -np.inf)
        origin = start - start % every
        handed = (origin < start) & (self.since[parents] <= origin)
        self.since[children] = _NEVER
        for t in np.unique(origin[handed]):
            here = handed & (origin == t)
            self.store_carry(int(t), children[here], batch.take(self.history[int(t)], parents[here]))

    def branch(self, parents: Integers, start: Integers, every: int = 1) -> tuple[tuple[int, Carry], ...]:
        """Return the stored carries of ``parents`` at their steps ``start``, which ascend."""
        stored = (self.since[parents] <= start) & (start % every == 0)
        parents, start = parents[stored], start[stored]
        return tuple(
            (int(t), batch.take(self.history[int(t)], parents[start == t])) for t in np.unique(start)
        )

    def past(self, parents: Integers, start: Integers, every: int = 1) -> Past | None:
        """Return how to rebuild the carries at ``start`` that are not stored; None if all are.

        The steps from the last one that should be stored count as simulated. A resumed estimate begins
        without any carries: the steps before do not count, as it would not have needed them.
        """
        origin = start - start % every
        stored = self.since[parents] <= origin
        rows = np.flatnonzero(~stored | (origin < start))
        if not len(rows):
            return None
        parents, paid, stored = parents[rows], (start - origin)[rows], stored[rows]
        origin = np.where(stored, origin[rows], FROM_START)
        carries = []
        for t in np.unique(origin[stored]):
            entries = np.flatnonzero(origin == t)
            carries.append((int(t), entries, batch.take(self.history[int(t)], parents[entries])))
        return Past(rows, origin, self.stage[parents], self.particle[parents], paid, tuple(carries))

    def store_carry(self, t: int, slots: Integers, carry: Carry) -> None:
        """Write the carries of ``slots`` at step ``t``."""
        self.since[slots] = np.minimum(self.since[slots], t)
        if t not in self.history:
            total = len(self.root)
            self.history[t] = batch.map_leaves(
                lambda leaf: np.zeros((total, *leaf.shape[1:]), leaf.dtype), carry
            )
        if not self._write(t, slots, carry):  # leaves that shared one array no longer do
            self.history[t] = batch.separate_leaves(self.history[t])
            self._write(t, slots, carry)

    def _write(self, t: int, slots: Integers, carry: Carry) -> bool:
        """Write leaf by leaf; return False where leaves that share an array would differ."""
        written: dict[int, NDArray[Any]] = {}
        for table, rows in zip(batch.leaves(self.history[t]), batch.leaves(carry), strict=True):
            if id(table) not in written:
                written[id(table)] = rows
                table[slots] = rows
            elif written[id(table)] is not rows:
                return False
        return True


@dataclass(frozen=True)
class Branches:
    """The rollouts asked for, sorted by ``start``.

    Attributes:
        slots: (M,) slots that they are stored in.
        parents: (M,) slots that they branch from.
        start: (M,) step that they branch at; -1: at the beginning.
    """

    slots: Integers
    parents: Integers
    start: Integers

    def steps(self, last: int, every: int) -> int:
        """Return the steps that count where all run to step ``last``, from the newest stored carry."""
        return int((last - np.where(self.start < 0, 0, self.start - self.start % every)).sum())
