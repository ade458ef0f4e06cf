"""Requests of an estimator to the rollout engine, the laws of their tapes, chunks, and outcomes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.protocols import Bools, Floats, Specification, System, Verdict

CHOICES = 3
"""Uniform numbers that decide what a proposal changes in a tape."""


class TapeProposal(Protocol):
    """Proposal of complete noise tapes, a mixture, that is drawn and weighed step by step.

    Attributes:
        digest: Hexadecimal digits that identify it.
        terms: A, the number of sums over the steps that its density needs.
    """

    @property
    def digest(self) -> str: ...  # noqa: D102

    @property
    def terms(self) -> int: ...  # noqa: D102

    def choose(self, uniform: Floats, sums: Floats | None = None) -> NDArray[Any]:
        """Return the changes of rows (M, ...) with these uniform numbers (M, CHOICES) in (0, 1).

        With ``sums`` (M, A) of the steps so far it is drawn given these steps: the rest of the tape then has
        the proposal's law given its beginning.
        """

    def transform(self, noise: Floats, chosen: NDArray[Any], first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return which of the A sums a step changes, (k,), and by how much, (k, M), for noise of the step."""

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p/q (M,) of the steps over which the sums (M, A) were taken; p is standard normal."""


Integers = NDArray[np.int64]

FROM_START = -1
ARRAYS = ("robustness", "violated", "error", "scores", "log_weight")
"""Fields of ``Rollouts`` with an entry for each row."""
WANTED_ARRAYS = ("features", "evidence")
"""Those that some requests ask for."""


@dataclass(frozen=True)
class Carry:
    """State of a particle between two steps, which splitting copies."""

    system: Any
    monitors: tuple[Any, ...]  # state of every specification's monitor
    verdicts: tuple[Verdict, ...]  # of every specification on the samples so far


@dataclass(frozen=True)
class Past:
    """Addresses of the noise with which rows without a stored carry reach their start."""

    rows: Integers  # (P,) rows of the request that have no carry, ascending; they are to reach ``start``
    origin: Integers  # (P,) step to simulate from: -1 the beginning, s >= 0 a carry at step s
    stage: NDArray[np.int32]  # (P, steps + 1) stage that drew the noise of each step up to ``start``
    particle: NDArray[np.int32]  # (P, steps + 1) particle that the noise was drawn for
    paid: Integers  # (P,) steps before ``start`` that count as simulated
    carries: tuple[tuple[int, Integers, Carry], ...] = ()
    """(s, entries, carry) in ascending s: carries of the entries (among the P, ascending) with origin s."""

    def slice(self, begin: int, end: int) -> Past | None:
        """Return the part for rows begin..end of the request, None if it is empty."""
        low, high = np.searchsorted(self.rows, (begin, end))
        if low == high:
            return None
        part, carries = slice(low, high), []
        for step, entries, carry in self.carries:
            first, last = np.searchsorted(entries, (low, high))
            if first < last:
                carries.append((step, entries[first:last] - low, batch.take(carry, slice(first, last))))
        return Past(
            self.rows[part] - begin,
            self.origin[part],
            self.stage[part],
            self.particle[part],
            self.paid[part],
            tuple(carries),
        )


@dataclass(frozen=True)
class Request:
    """Request for M rollouts, sorted by ``start``.

    Attributes:
        run: (M,) address of the fresh noise.
        stage: (M,) address of the fresh noise.
        particle: (M,) address of the fresh noise.
        start: (M,) step at which the row starts: -1 from the beginning, s >= 0 from a carry at step s.
        carries: (s, carry) pairs in ascending s; together they hold the rows with start >= 0 in order, but
            for those of ``past``.
        tape: (M, steps + 1, noise_size) explicit noise in place of addressed noise, or None.
        keep_carries: Return the carry of every step, or of steps 0, k, 2k, ... and the last; with ``until``
            of the last alone.
        every: k to begin with.
        most_bytes: Limit on a row's carries; k is doubled where they would take more. 0: no limit.
        stop_early: End a row as soon as all its verdicts are final.
        law: Distribution to draw from instead of the system's own, passed to ``under``; or None.
        tape_law: Law of the noise tapes; given ones are weighed against it. None: standard normal.
        evidence: (M, A) sums of the law's density over the steps up to ``start``; for rows that start later
            than at the beginning under a law.
        lineage: (M, S) rollouts that the rows continue, for checkpoints: rows of one address that continue
            others are other rows. None: the rollouts stored before decide it, digit for digit.
        past: Rows with start >= 0 whose carries must be simulated first; None: there are none.
        until: Last step of these rollouts, whose verdicts are then open; None: the problem's last step.
        observe: Steps at which to return the features of the state (``stack.features``).
        stop_failed: End a row as soon as it is violated whatever follows; for one specification.
        crash: End of the process, or the lack of an answer, by which all rows are errors at their next step.
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
    tape_law: TapeProposal | None = None
    evidence: Floats | None = None
    lineage: NDArray[np.int32] | None = None
    past: Past | None = None
    until: int | None = None
    observe: tuple[int, ...] = ()
    stop_failed: bool = False
    crash: str = ""

    @property
    def rows(self) -> int:
        """M, the number of rollouts."""
        return len(self.start)

    @property
    def is_fresh(self) -> bool:
        """True where all rows are new rollouts of the system's own law, from the beginning."""
        source = self.law or self.tape_law or self.tape is not None
        return not source and self.start[-1:].tolist() == [FROM_START]

    def describe(self) -> str:
        """Return where a worker is that runs it."""
        return (
            f"on the chunk of {self.rows} rollouts that begins at run {self.run[0]}, stage {self.stage[0]}, "
            f"particle {self.particle[0]}"
        )

    @staticmethod
    def from_start(run: Integers, particle: Integers, *, keep_carries: bool = False) -> Request:
        """Return a request for fresh rollouts of stage 0."""
        start = np.full(len(run), FROM_START)
        return Request(run, np.zeros_like(run), particle, start, keep_carries=keep_carries)

    @staticmethod
    def replay(tape: Floats, *, keep_carries: bool = False) -> Request:
        """Return a request for rollouts of given noise (M, steps + 1, noise_size)."""
        zeros = np.zeros(len(tape), dtype=np.int64)
        start = np.full(len(tape), FROM_START)
        return Request(zeros, zeros, zeros, start, tape=tape, keep_carries=keep_carries)

    def slice(self, begin: int, end: int) -> Request:
        """Return rows begin..end as a separate request: one chunk of work."""
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
            run=self.run[part],
            stage=self.stage[part],
            particle=self.particle[part],
            start=self.start[part],
            carries=tuple(carries),
            tape=None if self.tape is None else self.tape[part],
            evidence=None if self.evidence is None else self.evidence[part],
            lineage=None if self.lineage is None else self.lineage[part],
            past=None if self.past is None else self.past.slice(begin, end),
        )


@dataclass(frozen=True)
class Rollouts:
    """Outcome of a request; rows in the request's order, S specifications.

    Attributes:
        robustness: (M, S) robustness of the trace; for rows with an error, of the samples before it.
        violated: (M, S) verdicts; False for rows with an error.
        error: (M,) True where the row broke down.
        scores: (M, steps + 1) running score of the first specification; -inf before a row's start.
            (M, 0) where no score was requested.
        simulated_steps: Number of rows passed to ``System.step``.
        counts: Increments (M,) of the system's counters by name; 0 for rows with an error.
        messages: Causes of the first few errors.
        carries: (t, row indices, carry) by step, where they were requested.
        features: (M, K, F) features at the K steps asked for; NaN for rows that had left by then.
        evidence: (M, A) sums of the tape law's density over the steps so far, of requests with ``until``.
        every: Carries are those of steps 0, k, 2k, ... and the last, for this k.
        log_weight: (M,) log likelihood ratio p/q of the request's ``tape_law`` and of the numbers that the
            system itself reports, zeros where there is neither; rows that ended early have those until then.
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
    features: Floats = field(default_factory=lambda: np.zeros((0, 0, 0)))
    evidence: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @staticmethod
    def join(parts: list[Rollouts]) -> Rollouts:
        """Join the outcomes of consecutive chunks."""
        if len(parts) == 1:
            return parts[0]
        offsets = np.cumsum([0] + [len(part.error) for part in parts])
        widest = max(
            part.features.shape[2] for part in parts
        )  # 0 where no row of a part lived to be observed
        parts = [replace(part, features=widen(part.features, widest)) for part in parts]
        names = {name for part in parts for name in part.counts}
        return Rollouts(
            **{
                name: np.concatenate([getattr(part, name) for part in parts])
                for name in (*ARRAYS, *WANTED_ARRAYS)
            },
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
            every=max(part.every for part in parts),
        )


def widen(features: Floats, width: int) -> Floats:
    """Return features (M, K, F) with ``width`` columns, the further ones NaN."""
    missing = np.full((*features.shape[:2], width - features.shape[2]), np.nan, features.dtype)
    return np.concatenate([features, missing], axis=2)


LEAST, MOST = 25, 4096
WORLD_ROWS = 50
"""Rows of worlds that are simulated one at a time: a policy that acts on them all at once pays for fewer."""


def choose_chunk(system: System, monitors: tuple[Specification, ...], steps: int) -> int:
    """Return the largest number of rows per chunk, from the memory of one row and the steps of a rollout."""
    if system.lacks is not None:
        return WORLD_ROWS
    most_bytes = 2**22  # fewer rows cost more overhead than a cache saves
    most_steps = 2**17  # so that progress is seen and saved now and then
    rows = min(most_bytes // max(_bytes_of_a_row(system, monitors), 1), most_steps // max(steps, 1))
    return int(np.clip(rows, LEAST, MOST))


def spread(rows: int, chunk: int, workers: int) -> int:
    """Return the size of pieces, at most ``chunk``, that give all workers equally much."""
    rounds = math.ceil(rows / (chunk * workers))
    return math.ceil(rows / max(rounds * workers, 1))


def _bytes_of_a_row(system: System, monitors: tuple[Specification, ...]) -> int:
    try:
        state = system.initial(np.zeros((1, system.noise_size)))
        signals = system.signals(state)
        started = tuple(monitor.update(monitor.start(1), signals)[0] for monitor in monitors)
        return sum(leaf.nbytes for leaf in batch.leaves((state, started)))
    except (Exception, SystemExit):  # whatever is wrong is told, or counted, where the rollouts run
        return 0
