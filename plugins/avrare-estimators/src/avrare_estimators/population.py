"""The particles of R independent splitting runs, advanced together: R x N slots in one set of arrays.

The arrays are the estimator's own and are written in place: a stage touches only the rows it replaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare import batch
from avrare.protocols import Bools, Floats
from avrare.rollout.request import FROM_START, Carry, Integers, Past, Rollouts

_NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Tapes:
    """Where the noise of rollouts came from, enough to draw it again.

    Attributes:
        run: (F, 1).
        stage: (F, T + 1) as in ``Population``.
        particle: (F, T + 1) as in ``Population``.
        robustness: (F,).
    """

    run: Integers
    stage: NDArray[np.int32]
    particle: NDArray[np.int32]
    robustness: Floats


@dataclass(frozen=True)
class Population:
    """Slots of all runs; slot r * N + i is particle i of run r, T is the number of steps.

    Attributes:
        scores: (R N, T + 1) running score.
        violated: (R N,) the rollout breaks the specification.
        error: (R N,) the rollout broke down.
        robustness: (R N,).
        root: (R N,) slot of the first ancestor.
        stage: (R N, T + 1) stage that drew the noise of each step.
        particle: (R N, T + 1) particle that it was drawn for.
        since: (R N,) step from which on the history holds the slot's carries.
        history: Carry of every slot at each step t that is kept, once it is known.
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
        """Slots before the first rollout."""
        shape = (slots, steps + 1)
        own = np.arange(slots) % particles
        return Population(
            scores=np.full(shape, -np.inf),
            violated=np.zeros(slots, dtype=bool),
            error=np.zeros(slots, dtype=bool),
            robustness=np.full(slots, np.inf),
            root=np.arange(slots),
            stage=np.zeros(shape, dtype=np.int32),
            particle=np.repeat(own[:, None], steps + 1, axis=1).astype(np.int32),
            since=np.full(slots, _NEVER),
        )

    @property
    def final(self) -> Floats:
        """(R N,) score of the whole trace."""
        return self.scores[:, -1]

    def tapes(self, slots: Integers, particles: int) -> Tapes:
        """The tapes of ``slots``."""
        run = slots[:, None] // particles
        return Tapes(run, self.stage[slots], self.particle[slots], self.robustness[slots])

    def store(self, slots: Integers, start: Integers, outcome: Rollouts) -> None:
        """Write the rollouts of ``slots``, which were started at ``start`` (-1: from the beginning)."""
        fresh = np.arange(self.scores.shape[1]) > start[:, None]
        self.scores[slots] = np.where(fresh, outcome.scores, self.scores[slots])
        self.violated[slots] = outcome.violated[:, 0]
        self.error[slots] = outcome.error
        self.robustness[slots] = outcome.robustness[:, 0]
        given = np.zeros(len(slots), dtype=bool)
        for t, rows, carry in outcome.carries:
            given[rows] = True
            self.remember(t, slots[rows], carry)
        self.since[slots[~given]] = _NEVER

    def inherit(
        self, children: Integers, parents: Integers, start: Integers, stage: Integers, own: Integers,
        every: int = 1,
    ) -> None:  # fmt: skip
        """Give ``children`` the past of ``parents`` up to and including ``start``, new noise after it.

        Where carries are kept of ``every`` so many steps only, the newest before ``start`` is handed on.
        """
        past = np.arange(self.scores.shape[1]) <= start[:, None]
        self.root[children] = self.root[parents]
        for table, fresh in ((self.stage, stage), (self.particle, own)):
            table[children] = np.where(past, table[parents], fresh[:, None])
        self.scores[children] = np.where(past, self.scores[parents], -np.inf)
        origin = start - start % every
        handed = (origin < start) & (self.since[parents] <= origin)
        self.since[children] = _NEVER
        for t in np.unique(origin[handed]):
            here = handed & (origin == t)
            self.remember(int(t), children[here], batch.take(self.history[int(t)], parents[here]))

    def branch(self, parents: Integers, start: Integers, every: int = 1) -> tuple[tuple[int, Carry], ...]:
        """Carries of ``parents`` at their steps ``start``, which ascend, as far as they are kept."""
        kept = (self.since[parents] <= start) & (start % every == 0)
        parents, start = parents[kept], start[kept]
        return tuple(
            (int(t), batch.take(self.history[int(t)], parents[start == t])) for t in np.unique(start)
        )

    def past(self, parents: Integers, start: Integers, every: int = 1) -> Past | None:
        """How to come to the carries at ``start`` that are not kept, None: all are.

        The way from a step that should be kept counts as simulated. An estimate that is resumed begins
        without any carries: the rest of the way does not count, as it would not have been needed.
        """
        origin = start - start % every
        known = self.since[parents] <= origin
        rows = np.flatnonzero(~known | (origin < start))
        if not len(rows):
            return None
        parents, paid, known = parents[rows], (start - origin)[rows], known[rows]
        origin = np.where(known, origin[rows], FROM_START)
        carries = []
        for t in np.unique(origin[known]):
            entries = np.flatnonzero(origin == t)
            carries.append((int(t), entries, batch.take(self.history[int(t)], parents[entries])))
        return Past(rows, origin, self.stage[parents], self.particle[parents], paid, tuple(carries))

    def remember(self, t: int, slots: Integers, carry: Carry) -> None:
        """Write the carries of ``slots`` at step ``t``."""
        self.since[slots] = np.minimum(self.since[slots], t)
        if t not in self.history:
            total = len(self.root)
            self.history[t] = batch.map_leaves(
                lambda leaf: np.zeros((total, *leaf.shape[1:]), leaf.dtype), carry
            )

        if not self._write(t, slots, carry):  # leaves that were one array so far no longer are
            self.history[t] = batch.separated(self.history[t])
            self._write(t, slots, carry)

    def _write(self, t: int, slots: Integers, carry: Carry) -> bool:
        """Whether every array of the history could be given the one leaf that it stands for."""
        written: dict[int, NDArray[Any]] = {}
        for whole, rows in zip(batch.leaves(self.history[t]), batch.leaves(carry), strict=True):
            if id(whole) not in written:
                written[id(whole)] = rows
                whole[slots] = rows
            elif written[id(whole)] is not rows:
                return False
        return True
