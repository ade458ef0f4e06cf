"""What an estimator asks of the rollout engine, and what it gets back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare import batch
from avrare.protocols import Bools, Floats, Verdict

Integers = NDArray[np.int64]
FROM_START = -1


@dataclass(frozen=True)
class Carry:
    """All that a particle needs to go on: what splitting copies.

    Attributes:
        system: State of the system.
        monitors: Monitor state of every specification.
        verdicts: Verdict of every specification on the newest sample.
    """

    system: Any
    monitors: tuple[Any, ...]
    verdicts: tuple[Verdict, ...]


@dataclass(frozen=True)
class Past:
    """How to come to the carries of rows that were not kept: by driving there again, on the same noise.

    Attributes:
        rows: (P,) rows of the request that have no carry, ascending; ``start`` is where they are to be.
        origin: (P,) step to drive from: -1 the beginning, s >= 0 a carry at step s.
        stage: (P, steps + 1) stage that drew the noise of each step up to ``start``.
        particle: (P, steps + 1) particle that it was drawn for.
        paid: (P,) steps of the way that count as simulated.
        carries: (s, entries, carry) in ascending s: the carries of the entries (among the P) with origin s,
            which ascend.
    """

    rows: Integers
    origin: Integers
    stage: NDArray[np.int32]
    particle: NDArray[np.int32]
    paid: Integers
    carries: tuple[tuple[int, Integers, Carry], ...] = ()

    def slice(self, begin: int, end: int) -> Past | None:
        """What concerns rows begin..end of the request, None: nothing."""
        low, high = np.searchsorted(self.rows, (begin, end))
        if low == high:
            return None
        part, carries = slice(low, high), []
        for step, entries, carry in self.carries:
            first, last = np.searchsorted(entries, (low, high))
            if first < last:
                carries.append((step, entries[first:last] - low, batch.take(carry, slice(first, last))))
        return Past(
            self.rows[part] - begin, self.origin[part], self.stage[part], self.particle[part],
            self.paid[part], tuple(carries),
        )  # fmt: skip


@dataclass(frozen=True)
class Request:
    """M rollouts, sorted by ``start``.

    Attributes:
        run: (M,) address of the fresh noise.
        stage: (M,) address of the fresh noise.
        particle: (M,) address of the fresh noise.
        start: (M,) step at which the row starts: -1 from the beginning, s >= 0 from a carry at step s.
        carries: (s, carry) pairs in ascending s; together they hold the rows with start >= 0 in order, but
            for those of ``past``.
        tape: (M, steps + 1, noise_size) explicit noise in place of addressed noise, or None.
        keep_carries: Return the carry of every step, or of steps 0, k, 2k, ... and the last.
        every: k to begin with.
        most_bytes: Of a row's carries; k is doubled where they would take more. 0: no limit.
        stop_early: End a row as soon as no specification's verdict can change.
        law: What the system is to draw from instead of its own distribution: handed to ``System.under``.
        past: Rows with start >= 0 whose carries are to be driven to first; None: there are none.
    """

    run: Integers
    stage: Integers
    particle: Integers
    start: Integers
    carries: tuple[tuple[int, Carry], ...] = ()
    tape: Floats | None = None
    keep_carries: bool = False
    every: int = 1
    most_bytes: int = 0
    stop_early: bool = False
    law: Any = None
    past: Past | None = None

    @property
    def rows(self) -> int:
        """M, the number of rollouts."""
        return len(self.start)

    @staticmethod
    def from_start(run: Integers, particle: Integers, *, keep_carries: bool = False) -> Request:
        """Fresh rollouts of stage 0."""
        start = np.full(len(run), FROM_START)
        return Request(run, np.zeros_like(run), particle, start, keep_carries=keep_carries)

    @staticmethod
    def replay(tape: Floats, *, keep_carries: bool = False) -> Request:
        """Rollouts of given noise (M, steps + 1, noise_size)."""
        zeros = np.zeros(len(tape), dtype=np.int64)
        start = np.full(len(tape), FROM_START)
        return Request(zeros, zeros, zeros, start, tape=tape, keep_carries=keep_carries)

    def slice(self, begin: int, end: int) -> Request:
        """Rows begin..end as a request of their own: one chunk of work."""
        if begin <= 0 and end >= self.rows:
            return self
        part, carries = slice(begin, end), []
        carried = np.ones(self.rows, dtype=bool)
        if self.past is not None:
            carried[self.past.rows] = False
        before = np.concatenate([[0], np.cumsum(carried)])
        for step, carry in self.carries:
            first, last = np.searchsorted(self.start, (step, step + 1))
            low, high = before[max(begin, first)], before[min(end, last)]
            if low < high:
                carries.append((step, batch.take(carry, slice(low - before[first], high - before[first]))))
        return replace(
            self,
            run=self.run[part], stage=self.stage[part], particle=self.particle[part], start=self.start[part],
            carries=tuple(carries), tape=None if self.tape is None else self.tape[part],
            past=None if self.past is None else self.past.slice(begin, end),
        )  # fmt: skip


@dataclass(frozen=True)
class Rollouts:
    """Outcome of a request; rows in the request's order, S specifications.

    Attributes:
        robustness: (M, S) of the whole trace; of the samples before the error for errored rows.
        violated: (M, S) False for errored rows.
        error: (M,) the row broke down.
        scores: (M, steps + 1) running score of the first specification; -inf before a row's start.
            (M, 0) where no score was asked for.
        simulated_steps: Rows passed to ``System.step``.
        counts: What each row added to the system's own counters, (M,) each; 0 for errored rows.
        messages: What broke down, the first few.
        carries: (t, row indices, carry) of every step when they were asked for.
        every: k, where they are of steps 0, k, 2k, ... and the last only.
        log_weight: (M,) log likelihood ratio that the system reports, zeros where it reports none; of the
            steps before the error for errored rows.
    """

    robustness: Floats
    violated: Bools
    error: Bools
    scores: Floats
    simulated_steps: int
    counts: dict[str, Integers] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    carries: tuple[tuple[int, Integers, Carry], ...] = ()
    log_weight: Floats = field(default_factory=lambda: np.zeros(0))
    every: int = 1

    @staticmethod
    def join(parts: list[Rollouts]) -> Rollouts:
        """Outcomes of consecutive chunks as one."""
        if len(parts) == 1:
            return parts[0]
        offsets = np.cumsum([0] + [len(part.error) for part in parts])
        names = {name for part in parts for name in part.counts}
        return Rollouts(
            robustness=np.concatenate([part.robustness for part in parts]),
            violated=np.concatenate([part.violated for part in parts]),
            error=np.concatenate([part.error for part in parts]),
            scores=np.concatenate([part.scores for part in parts]),
            simulated_steps=sum(part.simulated_steps for part in parts),
            counts={
                name: np.concatenate(
                    [part.counts.get(name, np.zeros(len(part.error), np.int64)) for part in parts]
                )
                for name in sorted(names)
            },
            messages=tuple(dict.fromkeys(m for part in parts for m in part.messages))[:5],
            carries=tuple(
                (step, rows + offset, carry)
                for part, offset in zip(parts, offsets, strict=False)
                for step, rows, carry in part.carries
            ),
            log_weight=np.concatenate([part.log_weight for part in parts]),
            every=max(part.every for part in parts),
        )


def total_counts(outcomes: Iterable[Rollouts]) -> dict[str, int]:
    """The systems' counters, summed over all rollouts."""
    total: dict[str, int] = {}
    for outcome in outcomes:
        for name, values in outcome.counts.items():
            total[name] = total.get(name, 0) + int(values.sum())
    return dict(sorted(total.items()))
