"""Particles of sequential Monte Carlo: R runs of N weighted rollouts that advance together, in segments.

The weight of a particle is true at any time: summed over the particles of a run, indicators of an event
of their paths estimate its probability under the target without bias. Resampling copies a particle in
proportion to weight times potential and gives each copy its share of the weight, which keeps this so for any
potential and whenever it is done (Del Moral and Garnier 2005; Whiteley and Lee 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.estimation.plan.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import FROM_START, Carry, Integers, Past, Request, Rollouts, TapeProposal, widen
from avrare.rollout.tape_source import draw_lineage
from avrare_estimators.common.weights import effective_size, resample
from avrare_estimators.smc.potentials import Paths, Potentials

_LEAST_EFFECTIVE = 0.7
"""Share of a run's particles below whose effective number they are resampled."""


@dataclass(frozen=True)
class Rows:
    """Particles, those of a run together.

    Attributes:
        run: (n,) run, from 0.
        weight: (n,) weight; of a run's first particles, on average 1 / N.
        root: (n,) number of the first ancestor.
        lineage: (n, S) particle for which the noise of each segment was drawn; -1 after the end.
        features: (n, K, F) features at the schedule's steps, or (n, 0, 0) where they are not kept.
    """

    run: Integers
    weight: Floats
    root: Integers
    lineage: NDArray[np.int32]
    features: Floats


@dataclass(frozen=True)
class Ends:
    """Particles that have ended.

    Attributes:
        rows: The particles.
        violated: (n,) it fails.
        error: (n,) it broke down.
        robustness: (n,).
        score: (n,) running score at its end.
    """

    rows: Rows
    violated: Bools
    error: Bools
    robustness: Floats
    score: Floats


@dataclass(frozen=True)
class Course:
    """Parts that the runs of a task share.

    Attributes:
        plan: The task.
        particles: N, particles of a run.
        law: Law that tapes are drawn from, a ``DefendedMixture``; None: the target.
        schedule: (K,) steps whose features are learnt from.
        potentials: Where to resample; None: nowhere.
        stage: Address "stage" of the first segment.
        learning: Keep features for learning; segments then end at all steps of the schedule.
    """

    plan: Plan
    particles: int
    law: TapeProposal | None
    schedule: Integers
    potentials: Potentials | None
    stage: int
    learning: bool

    @property
    def stops(self) -> list[int]:
        """Numbers of the scheduled steps at which segments end."""
        if self.learning:
            return list(range(len(self.schedule)))
        return self.potentials.useful if self.potentials is not None else []

    @property
    def ends(self) -> list[int]:
        """Last step of each segment."""
        return [*(int(self.schedule[k]) for k in self.stops), self.plan.steps]


@dataclass(frozen=True)
class Particles:
    """R runs between two segments.

    Attributes:
        course: What the runs share.
        first_run: Address of the first run's noise.
        runs: R.
        segment: Number of the segment to run next.
        rows: Particles that go on.
        carry: State of those that have one at hand.
        carried: (n,) it has.
        evidence: (n, A) sums of the law's density.
        log_ratio: (n,) log p/q of the steps so far.
        ends: Those that have ended.
        copies: Particles that began as a copy.
        resampled: Number of runs that were resampled after each segment.
    """

    course: Course
    first_run: int
    runs: int
    segment: int
    rows: Rows
    carry: Carry | None
    carried: Bools
    evidence: Floats | None
    log_ratio: Floats
    ends: tuple[Ends, ...] = ()
    copies: int = 0
    resampled: tuple[int, ...] = ()

    @staticmethod
    def begin(course: Course, first_run: int, runs: int) -> Particles:
        """Return the particles before the first segment."""
        n, scheduled = runs * course.particles, len(course.schedule)
        rows = Rows(
            np.repeat(np.arange(runs), course.particles),
            np.full(n, 1.0 / course.particles),
            np.arange(n),
            np.full((n, len(course.ends)), -1, dtype=np.int32),
            np.full((n, scheduled if course.learning else 0, 0), np.nan),
        )
        none = np.zeros(n, dtype=bool)
        return Particles(course, first_run, runs, 0, rows, None, none, None, np.zeros(n))

    @property
    def done(self) -> bool:
        """Nothing is left to run."""
        return self.segment == len(self.course.ends) or not len(self.rows.run)

    @property
    def last(self) -> bool:
        """The next segment is the last."""
        return self.segment == len(self.course.ends) - 1

    def request(self) -> Request:
        """Return the request for the next segment."""
        course, n = self.course, len(self.rows.run)
        begin = course.ends[self.segment - 1] if self.segment else FROM_START
        start = np.full(n, begin)
        fields: dict[str, Any] = {}
        if self.segment:
            carries = () if self.carry is None else ((begin, self.carry),)
            fields |= {"carries": carries, "past": self._past(start), "evidence": self.evidence}
            fields |= {"lineage": self.rows.lineage[:, : self.segment]}
        if not self.last:
            end = course.ends[self.segment]
            fields |= {"until": end, "observe": (end,), "keep_carries": True}
        return Request(
            self.rows.run + self.first_run,
            np.full(n, course.stage + self.segment),
            self._particle_index(),
            start,
            tape_law=course.law,
            stop_failed=True,
            **fields,
        )

    def _particle_index(self) -> Integers:
        """Return the particle of each row: its place in its run."""
        run = self.rows.run
        return np.arange(len(run)) - np.searchsorted(run, run)

    def _past(self, start: Integers) -> Past | None:
        missing = np.flatnonzero(~self.carried)
        if not len(missing):
            return None
        stage, particle = addresses(self.course, self.rows.lineage[missing])
        none = np.zeros(len(missing), dtype=np.int64)
        return Past(
            missing, none + FROM_START, stage.astype(np.int32), particle.astype(np.int32), none
        )  # a resumed estimate has paid for these steps before

    def tell(self, outcome: Rollouts) -> Particles:
        """Take in the segment: some rows end, the others are resampled where that helps."""
        numbers = self._particle_index()
        rows = replace(self.rows, lineage=self.rows.lineage.copy())
        rows.lineage[:, self.segment] = numbers
        ratio = outcome.log_weight
        rows = replace(rows, weight=rows.weight * np.exp(ratio - self.log_ratio))
        end = outcome.violated[:, 0] | outcome.error | self.last
        features = outcome.features[:, 0] if outcome.features.shape[1] else None
        rows = self._observe(rows, features)
        ended = Ends(
            batch.take(rows, end),
            outcome.violated[end, 0],
            outcome.error[end],
            outcome.robustness[end, 0],
            outcome.scores[end, -1] if outcome.scores.shape[1] else -outcome.robustness[end, 0],
        )
        going = np.flatnonzero(~end)
        place = np.full(len(end), -1)
        carries = [carry for _, _, carry in outcome.carries]
        carried = np.concatenate([np.zeros(0, np.int64), *(rows for _, rows, _ in outcome.carries)])
        place[carried] = np.arange(len(carried))
        state = replace(
            self,
            segment=self.segment + 1,
            rows=batch.take(rows, going),
            ends=(*self.ends, ended),
            carry=batch.concatenate(carries) if carries else None,
            evidence=outcome.evidence[going],
            log_ratio=ratio[going],
        )
        if state.done:
            return replace(state, carry=None, carried=np.zeros(len(going), dtype=bool))
        assert features is not None
        return state._resample(features[going], place[going])

    def _observe(self, rows: Rows, features: Floats | None) -> Rows:
        if features is None or not self.course.learning:
            return rows
        table, k = rows.features, self.course.stops[self.segment]
        empty = np.full((*table.shape[:2], features.shape[1]), np.nan)
        table = table.copy() if table.shape[2] else empty
        table[:, k] = features
        return replace(rows, features=table)

    def _resample(self, features: Floats, place: Integers) -> Particles:
        """Return the state with copies; ``place`` (n,) of each row's carry in ``self.carry``, -1: none."""
        course, rows = self.course, self.rows
        k = course.stops[self.segment - 1]
        h = np.ones(len(rows.run))
        if course.potentials is not None and k in course.potentials.useful:
            h = course.potentials(k, features)
        parents, weights, resampled = [], [], 0
        for run in range(self.runs):
            low, high = np.searchsorted(rows.run, (run, run + 1))
            chosen, share, copied = self._choose(run, rows.weight[low:high], h[low:high])
            parents.append(low + chosen)
            weights.append(share)
            resampled += copied
        index = np.concatenate(parents)
        chosen_rows = replace(batch.take(rows, index), weight=np.concatenate(weights))
        place = place[index]
        carried = place >= 0
        carry = batch.take(self.carry, place[carried]) if self.carry is not None and carried.any() else None
        assert self.evidence is not None
        return replace(
            self,
            rows=chosen_rows,
            carry=carry,
            carried=carried,
            evidence=self.evidence[index],
            log_ratio=self.log_ratio[index],
            copies=self.copies + len(index) - len(np.unique(index)),
            resampled=(*self.resampled, resampled),
        )

    def _choose(self, run: int, weight: Floats, h: Floats) -> tuple[Integers, Floats, bool]:
        """Return parents and weights of a run's particles, and whether it was resampled."""
        size, particles = len(weight), self.course.particles
        target = weight * h
        enough = effective_size(target) >= _LEAST_EFFECTIVE * size and size >= particles // 2
        if not target.any() or enough:
            return np.arange(size), weight, False
        # Sorted by potential: systematic resampling then keeps their distribution best.
        order = np.argsort(h, kind="stable")
        # beyond the particles of a run
        address = self.first_run + run, self.course.stage + self.segment, 2**32 - 1
        uniform = float(self.course.plan.noise.choices(*address))
        parents = order[resample(target[order], particles, uniform)]
        copies = particles * target[parents] / target.sum()
        return parents, weight[parents] / copies, True

    def list_ended_particles(self) -> Ends:
        """Return all particles that have ended, those of a run together."""
        # Of a part whose rows all ended before they were observed the number of features is not known.
        width = max(ends.rows.features.shape[2] for ends in self.ends)
        parts = [
            replace(ends, rows=replace(ends.rows, features=widen(ends.rows.features, width)))
            for ends in self.ends
        ]
        joined = batch.concatenate(parts)
        return batch.take(joined, np.argsort(joined.rows.run, kind="stable"))

    def paths(self) -> Paths:
        """Return the rollouts for learning, without those that broke down."""
        ends = self.list_ended_particles()
        alive = ~ends.error
        rows = batch.take(ends.rows, alive)
        weights = rows.weight * len(rows.run) / self.runs
        return Paths(rows.features, ends.score[alive], ends.violated[alive], weights, rows.root)


def addresses(course: Course, lineage: NDArray[np.int32]) -> tuple[Integers, Integers]:
    """Return stage and particle (n, steps + 1) of the noise of rows with a lineage (n, S).

    Steps after a row's end belong to its last segment.
    """
    segment = np.searchsorted(np.array(course.ends), np.arange(course.plan.steps + 1))
    segments = np.minimum(segment, (lineage >= 0).sum(axis=1)[:, None] - 1)
    return course.stage + segments, np.take_along_axis(lineage, segments, axis=1).astype(np.int64)


def draw_tapes(course: Course, first_run: int, rows: Rows) -> Floats:
    """Draw the tapes (n, steps + 1, noise_size) of ended rows again."""
    if not len(rows.run):
        return np.zeros((0, course.plan.steps + 1, course.plan.noise.noise_size))
    stage, particle = addresses(course, rows.lineage)
    run = (rows.run + first_run)[:, None]
    return draw_lineage(course.plan.noise, course.law, run, stage, particle)
