"""State of adaptive multilevel splitting: R runs of N particles, as R x N slots in one set of arrays.

The arrays belong to the estimator and are written in place: a stage touches only the rows it replaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.protocols import Bools, Floats
from avrare.rollout.request import FROM_START, Integers
from avrare_estimators.ams.leaps import Leaps
from avrare_estimators.ams.population import Branches, Population, TapeAddresses
from avrare_estimators.common.in_turn import take_in_turn
from avrare_estimators.common.looks import Looks, Pilot

_SLOT, _ENTRY = 200, 34
"""Bytes of a slot at the peak, and of each of its steps: tables, and the scores of a first stage twice."""


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

    def join(self, other: EndedRuns, most: int) -> EndedRuns:
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
            **arrays,
            levels=self.levels + other.levels,
            failing=thin(failing, most),
            retired_failures=thin(retired, most),
            worst=_least_robust(worst),
        )

    @property
    def runs(self) -> int:
        """R."""
        return len(self.weight)

    @property
    def probabilities(self) -> Floats:
        """(R,) unbiased at every stage: discarded failures count too, with the weight that they had."""
        return np.asarray(self.retired + self.weight * self.violated.mean(axis=1))


def thin(tapes: TapeAddresses, most: int) -> TapeAddresses:
    """Return at most ``most`` tapes, of all runs alike."""
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
        pilot: Findings of the pilot, if there was one.
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
            plan,
            runs,
            Population.empty(len(slots), particles, plan.steps),
            weight=np.ones(runs),
            pairs=np.full(runs, 1.0 / (particles * (particles - 1))),
            retired=np.zeros(runs),
            error_weight=np.zeros(runs),
            active=np.ones(runs, dtype=bool),
            pending=Branches(slots, slots, np.full(len(slots), FROM_START)),
            levels=tuple([] for _ in range(runs)),
            **fields,
        )

    def next_batch(self, runs: int) -> AmsState:
        """Begin further runs; what these have found stays."""
        ended = self.finish()
        return AmsState.begin(
            self.plan,
            runs,
            self.particles,
            first=self.first,
            fresh=self.fresh,
            tally=self.tally,
            first_run=ended.runs,
            growth=self.growth,
            looks=self.looks,
            pilot=self.pilot,
            ended=ended,
            saved=self.saved,
            leaps=self.leaps,
        )

    @property
    def probabilities(self) -> Floats:
        """Estimates of all runs so far; unbiased at every stage."""
        share = self.population.violated.reshape(self.runs, -1).mean(axis=1)
        probabilities = np.asarray(self.retired + self.weight * share)
        return (
            probabilities if self.ended is None else np.concatenate([self.ended.probabilities, probabilities])
        )

    def finish(self) -> EndedRuns:
        """Return all runs so far, these included, as they would be if they ended now."""
        population, most, shape = self.population, self.plan.kept_failures, (self.runs, self.particles)
        none = population.addresses(np.zeros(0, dtype=np.int64), self.particles, 0)
        retired = batch.concatenate([none, *self.discarded_failures])
        alive = np.flatnonzero(~population.error)
        best = alive[np.argsort(population.robustness[alive], kind="stable")[:1]]
        least_robust = population.addresses(best, self.particles, self.first_run)
        failing = np.flatnonzero(population.violated)
        failing = failing[take_in_turn(failing // self.particles, most)]
        runs = EndedRuns(
            self.weight,
            self.pairs,
            self.retired,
            self.error_weight,
            self.levels,
            population.violated.reshape(shape),
            population.error.reshape(shape),
            population.root.reshape(shape),
            population.addresses(failing, self.particles, self.first_run),
            retired,
            _least_robust(batch.concatenate([least_robust, retired])),
        )
        return runs if self.ended is None else self.ended.join(runs, most)

    @property
    def done(self) -> int:
        """Runs so far, these included."""
        return self.runs + (self.ended.runs if self.ended is not None else 0)

    @property
    def particles(self) -> int:
        """N, of each run."""
        return len(self.population.root) // self.runs


def run_bytes(plan: Plan, particles: int) -> int:
    """Return the bytes of a run at its peak, except for the carries."""
    return particles * (_SLOT + _ENTRY * (plan.steps + 1))
