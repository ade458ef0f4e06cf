"""State of adaptive multilevel splitting: R runs of N particles, as R x N slots in one set of arrays.

The arrays belong to the estimator and are written in place: a stage touches only the rows it replaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.estimation.plan import Info, Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import FROM_START, Carry, Integers, Past, Rollouts
from avrare_estimators.ams.leaps import Leaps
from avrare_estimators.fresh import FreshRows
from avrare_estimators.in_turn import take_in_turn
from avrare_estimators.looks import Looks, Pilot

_NEVER = np.iinfo(np.int64).max
_BLOCK = 2**18
"""Scores that are written at once."""
_SLOT, _ENTRY = 200, 34
"""Bytes of a slot at the peak, and of each of its steps: tables, and the scores of a first stage twice."""


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
            part = slice(begin, begin + size)
            old = self.scores[slots[part]]
            self.scores[slots[part]] = np.where(steps > start[part, None], outcome.scores[part], old)
        self.violated[slots] = outcome.violated[:, 0]
        self.error[slots] = outcome.error
        self.robustness[slots] = outcome.robustness[:, 0]
        given = np.zeros(len(slots), dtype=bool)
        for t, rows, carry in outcome.carries:
            given[rows] = True
            self.store_carry(t, slots[rows], carry)
        self.since[slots[~given]] = _NEVER

    def inherit(
        self, children: Integers, parents: Integers, start: Integers, stage: Integers, own: Integers,
        every: int = 1,
    ) -> None:  # fmt: skip
        """Give ``children`` the past of ``parents`` up to and including ``start``, new noise after it.

        Where only the carries of every so many steps are stored, the newest before ``start`` is handed on.
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

    def store_carry(self, t: int, slots: Integers, carry: Carry) -> None:
        """Write the carries of ``slots`` at step ``t``."""
        self.since[slots] = np.minimum(self.since[slots], t)
        if t not in self.history:
            total = len(self.root)
            self.history[t] = batch.map_leaves(
                lambda leaf: np.zeros((total, *leaf.shape[1:]), leaf.dtype), carry
            )
        if not self._write(t, slots, carry):  # leaves that shared one array no longer do
            self.history[t] = batch.separated(self.history[t])
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


@dataclass(frozen=True)
class EndedRuns:
    """Numbers of R ended runs that a result needs; their tables are gone.

    Attributes:
        weight: (R,), and the next three, as in ``AmsState``.
        pairs: (R,).
        retired: (R,).
        error_weight: (R,).
        levels: As in ``AmsState``.
        violated: (R, N) the rollout violates the specification.
        error: (R, N) the rollout broke down.
        root: (R, N) first ancestor.
        failing: Tapes of failures that were alive at the end, some of each run.
        retired_failures: Tapes of discarded failures, the first few.
        worst: Tape of the least robust rollout; none where all broke down.
    """

    weight: Floats
    pairs: Floats
    retired: Floats
    error_weight: Floats
    levels: tuple[list[tuple[float, int]], ...]
    violated: Bools
    error: Bools
    root: Integers
    failing: TapeAddresses
    retired_failures: TapeAddresses
    worst: TapeAddresses

    def joined(self, other: EndedRuns, most: int) -> EndedRuns:
        """Return these runs and then those of ``other``, with at most so many tapes of each kind."""
        names = ("weight", "pairs", "retired", "error_weight", "violated", "error", "root")
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names
        }
        failing, retired, worst = (
            batch.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("failing", "retired_failures", "worst")
        )
        return EndedRuns(
            **arrays, levels=self.levels + other.levels, failing=thin(failing, most),
            retired_failures=thin(retired, most), worst=_least_robust(worst),
        )  # fmt: skip

    @property
    def runs(self) -> int:
        """R."""
        return len(self.weight)

    @property
    def probabilities(self) -> Floats:
        """(R,) unbiased at every stage: discarded failures count too, with the weight that they had."""
        return np.asarray(self.retired + self.weight * self.violated.mean(axis=1))


def thin(tapes: TapeAddresses, most: int) -> TapeAddresses:
    """Return at most so many tapes, of all runs alike."""
    return batch.take(tapes, take_in_turn(tapes.run[:, 0], most))


def _least_robust(tapes: TapeAddresses) -> TapeAddresses:
    least = np.argsort(tapes.robustness, kind="stable")[:1]
    return batch.take(tapes, least)


@dataclass(frozen=True)
class AmsState:
    """State of R runs; the population and the per-run arrays are written in place.

    Attributes:
        plan: The task.
        runs: R.
        population: R x N slots.
        weight: (R,) product of the surviving shares.
        pairs: (R,) factor of the genealogical variance estimate (docs/statistics.md).
        retired: (R,) weight of the discarded failures: a score may put them below others.
        error_weight: (R,) weight of the discarded particles that had broken down.
        active: (R,) the run has not ended.
        pending: The rollouts asked for next.
        levels: Level and number discarded of each stage, per run.
        stage: Number of stages done.
        discarded_failures: Tapes of discarded failures, the first few.
        first: Robustness of the first stage's rollouts, NaN for errors.
        fresh: Their counts.
        tally: Cost so far.
        every: Number of steps from one stored carry to the next.
        first_run: Address of the noise of the first of these runs.
        growth: Factor of the particles and discards over those of the options.
        looks: When to stop; None: this is the pilot.
        pilot: What the pilot has found, if there was one.
        ended: Runs before these, which come in batches that fit into memory.
        saved: Steps of rollouts that ended early.
        leaps: First rollouts that came to a high level in a single step.
    """

    plan: Plan
    runs: int
    population: Population
    weight: Floats
    pairs: Floats
    retired: Floats
    error_weight: Floats
    active: Bools
    pending: Branches
    levels: tuple[list[tuple[float, int]], ...]
    stage: int = 0
    discarded_failures: list[TapeAddresses] = field(default_factory=list)
    first: Floats = field(default_factory=lambda: np.zeros(0))
    fresh: FreshRows = field(default_factory=FreshRows)
    tally: Info = field(default_factory=Info)
    every: int = 1
    first_run: int = 0
    growth: int = 1
    looks: Looks | None = None
    pilot: Pilot | None = None
    ended: EndedRuns | None = None
    saved: int = 0
    leaps: Leaps = field(default_factory=Leaps)

    @staticmethod
    def begin(plan: Plan, runs: int, particles: int, **fields: Any) -> AmsState:
        """Return the state before the first rollout."""
        slots = np.arange(runs * particles)
        return AmsState(
            plan, runs, Population.empty(len(slots), particles, plan.steps),
            weight=np.ones(runs), pairs=np.full(runs, 1.0 / (particles * (particles - 1))),
            retired=np.zeros(runs), error_weight=np.zeros(runs), active=np.ones(runs, dtype=bool),
            pending=Branches(slots, slots, np.full(len(slots), FROM_START)),
            levels=tuple([] for _ in range(runs)), **fields,
        )  # fmt: skip

    def next_batch(self, runs: int) -> AmsState:
        """Begin further runs; what these have found stays."""
        ended = self.finished()
        return AmsState.begin(
            self.plan, runs, self.particles, first=self.first, fresh=self.fresh, tally=self.tally,
            first_run=ended.runs, growth=self.growth, looks=self.looks, pilot=self.pilot, ended=ended,
            saved=self.saved, leaps=self.leaps,
        )  # fmt: skip

    @property
    def probabilities(self) -> Floats:
        """Estimates of all runs so far; unbiased at every stage."""
        share = self.population.violated.reshape(self.runs, -1).mean(axis=1)
        own = np.asarray(self.retired + self.weight * share)
        return own if self.ended is None else np.concatenate([self.ended.probabilities, own])

    def finished(self) -> EndedRuns:
        """Return all runs so far, these included, as they would be if they ended now."""
        population, most, shape = self.population, self.plan.kept_failures, (self.runs, self.particles)
        none = population.addresses(np.zeros(0, dtype=np.int64), self.particles, 0)
        retired = batch.concatenate([none, *self.discarded_failures])
        alive = np.flatnonzero(~population.error)
        best = alive[np.argsort(population.robustness[alive], kind="stable")[:1]]
        own = population.addresses(best, self.particles, self.first_run)
        failing = np.flatnonzero(population.violated)
        failing = failing[take_in_turn(failing // self.particles, most)]
        found = EndedRuns(
            self.weight, self.pairs, self.retired, self.error_weight, self.levels,
            population.violated.reshape(shape), population.error.reshape(shape),
            population.root.reshape(shape),
            population.addresses(failing, self.particles, self.first_run), retired,
            _least_robust(batch.concatenate([own, retired])),
        )  # fmt: skip
        return found if self.ended is None else self.ended.joined(found, most)

    @property
    def done(self) -> int:
        """Runs so far, these included."""
        return self.runs + (self.ended.runs if self.ended is not None else 0)

    @property
    def particles(self) -> int:
        """N, of each run."""
        return len(self.population.root) // self.runs


def run_bytes(plan: Plan, particles: int) -> int:
    """Return the bytes of a run at its peak, but for the carries."""
    return particles * (_SLOT + _ENTRY * (plan.steps + 1))
