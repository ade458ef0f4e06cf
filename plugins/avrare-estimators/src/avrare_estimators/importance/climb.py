"""Climb: from a weighted sample of an entry level on to failure, by Markov chains on the noise tape.

A group is a sample of its own: rows from proposal and target, whose weights give the probability to enter,
and chains that start at rows that have entered, drawn in proportion to their weights. The chains pass nested
levels as those of ``ess`` do, at levels and with kernels that a pilot has fixed. A group's product of shares
is unbiased (a sequential Monte Carlo sampler: Del Moral, Doucet and Jasra 2006), groups are independent, and
their scatter gives the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from avrare.estimation.plan.plan import Plan
from avrare.estimation.result.result import Failures, spread
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.common.chains.kernel import Points
from avrare_estimators.common.chains.level_pass import LevelPass, PassShape
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.common.lessons.lessons import Lessons
from avrare_estimators.common.samples.groups import Groups
from avrare_estimators.common.samples.sampling import PartialSample, Sample, failing_weights
from avrare_estimators.common.samples.sources import Stratum, TapeSource
from avrare_estimators.common.weights import mixture_log_weights, resample
from avrare_estimators.importance.entry import LENGTH, Entry
from avrare_estimators.importance.route import GroupSize, Route

_FLOOR = 1e-18
_DOUBT, _FLATTERED = 1.5, 3.0
"""Factors by which a climb may cost more than its pilot says, and a sample without chains: few failures
seldom show what the proposal does not cover."""
_KEPT = 8
"""Failures that are kept of a group."""
_PILOT_STAGE, _STAGE, _STAGES_OF_RUN = 2**28, 2**29, 2**24


@dataclass(frozen=True)
class ClimbPilot:
    """One group of chains that finds the levels above an entry, from rows that the lessons know.

    Attributes:
        entry: The entry.
        level_pass: The chains.
    """

    entry: Entry
    level_pass: LevelPass

    @staticmethod
    def begin(plan: Plan, lessons: Lessons, entry: Entry, chains: int, run: int, rollouts: int) -> ClimbPilot:
        """Begin at rows of the lessons above the entry level; at most so many rollouts follow."""
        shape = _shape(1, chains, _PILOT_STAGE + run * _STAGES_OF_RUN)
        rows = np.flatnonzero(lessons.key > entry.level)
        chosen = rows[resample(lessons.weights[rows], shape.samples, 0.5)]
        share = np.array([entry.probability])
        points = points_of(lessons.samples, chosen)
        most = rollouts // shape.moves
        began = LevelPass.begin_from(plan, shape, PcnKernel(), points, share, first=entry.level, most=most)
        return ClimbPilot(entry, began)

    @property
    def pending(self) -> Request | None:
        """The rollouts asked for; None at the end."""
        return _asked(self.level_pass)

    def tell(self, rollouts: Rollouts) -> ClimbPilot:
        """Continue."""
        return replace(self, level_pass=self.level_pass.tell(rollouts))

    def route(self) -> Route:
        """Return what the chains have found, once they are done."""
        return Route.of(self.entry, self.level_pass)

    def pays(self, defensive: float) -> bool:
        """Return whether a climb is expected to cost less than Monte Carlo, and than a sample without chains.

        The chains' failures judge what a row of such a sample is worth: they are drawn from the target,
        whatever the proposal covers.
        """
        route, points = self.route(), self.level_pass.points
        if not route.reached or _DOUBT * route.cost() > 1.0 / route.reached - 1.0:
            return False
        if self.entry.mixture is None:
            return True
        ratio = self.entry.mixture.log_ratio_of(points.tape[points.violated])
        weight = np.exp(mixture_log_weights(ratio, defensive))
        return route.cost() < _FLATTERED * (float(weight.mean()) / route.reached - 1.0)


@dataclass(frozen=True)
class ClimbBatch:
    """Groups under way together: first their samples, then their chains.

    Attributes:
        plan: The task.
        route: The route.
        size: Size of a group.
        groups: Number of groups.
        first: Number of groups before this batch.
        run: Index of the run.
        starts: The sample of all groups; None once it is complete.
        sample: The complete sample.
        entered: (groups,) probability to enter of each group.
        errors: (groups,) weight of the rows that broke down.
        level_pass: The chains.
    """

    plan: Plan
    route: Route
    size: GroupSize
    groups: int
    first: int
    run: int
    starts: PartialSample | None
    sample: Sample | None = None
    entered: Floats = field(default_factory=lambda: np.zeros(0))
    errors: Floats = field(default_factory=lambda: np.zeros(0))
    level_pass: LevelPass | None = None

    @staticmethod
    def begin(
        plan: Plan,
        route: Route,
        size: GroupSize,
        groups: int,
        first: int,
        run: int,
        stage: int,
        defensive: float,
        wave: int,
    ) -> ClimbBatch:
        """Begin with the samples. Their addresses, (run, stage) and (run, stage + 1), know of no batch."""
        source, target = TapeSource(route.entry.mixture), size.rows
        if source.mixture is not None:
            target = max(1, round(defensive * size.rows))
        strata = (
            Stratum(plan, run, stage, groups * target, True, first * target),
            Stratum(plan, run, stage + 1, groups * (size.rows - target), False, first * (size.rows - target)),
        )
        starts = PartialSample.of(source, strata, wave)
        return ClimbBatch(plan, route, size, groups, first, run, starts)

    @property
    def pending(self) -> Request | None:
        """The rollouts asked for; None at the end."""
        if self.starts is not None:
            return self.starts.pending
        return _asked(self.level_pass) if self.level_pass is not None else None

    def tell(self, rollouts: Rollouts) -> ClimbBatch:
        """Continue the samples, or the chains."""
        if self.starts is None:
            assert self.level_pass is not None
            return replace(self, level_pass=self.level_pass.tell(rollouts))
        starts = self.starts.tell(rollouts)
        after = replace(self, starts=starts)
        return after if starts.pending is not None else after._begin_chains(starts.sample().without_carries())

    def _begin_chains(self, sample: Sample) -> ClimbBatch:
        # 1. The probability to enter, from the weights of each group's rows.
        group = self._group(sample)
        weight = failing_weights(sample.reaching(self.route.entry.level))
        entered = np.bincount(group, weight, minlength=self.groups) / self.size.rows
        # 2. Rows that have entered, in proportion to their weights.
        shape = _shape(self.groups, self.size.chains, _STAGE + self.run * _STAGES_OF_RUN)
        noise = self.plan.noise
        noise = NoiseSource(noise.seed, noise.noise_size, first_run=noise.first_run + self.first)
        uniforms = noise.choices(np.arange(self.groups), shape.stage - 1, 0)
        chosen = np.zeros((self.groups, shape.samples), dtype=np.int64)
        for g in np.flatnonzero(entered):
            rows = np.flatnonzero((group == g) & (weight > 0.0))
            chosen[g] = rows[resample(weight[rows], shape.samples, uniforms[g])]
        # 3. Chains from there, at the levels of the pilot.
        points = points_of([sample], chosen.ravel())
        points = replace(points, root=self._place_in_group(sample)[chosen.ravel()])
        chains = LevelPass.begin_from(
            replace(self.plan, noise=noise),
            shape,
            PcnKernel(),
            points,
            entered,
            self.route.schedule(self.groups),
        )
        broken = np.where(sample.error, np.exp(sample.log_weights), 0.0)
        errors = np.bincount(group, broken, minlength=self.groups) / self.size.rows
        return replace(self, starts=None, sample=sample, entered=entered, errors=errors, level_pass=chains)

    def _group(self, sample: Sample) -> Integers:
        """Return the group (n,) of each row: each has as many rows of the target, and of the proposal."""
        return np.concatenate(
            [np.arange(one.rows) // max(1, one.rows // self.groups) for one in sample.strata]
        )

    def _place_in_group(self, sample: Sample) -> Integers:
        """Return the number (n,) of each row in its group."""
        target, proposal = (np.arange(one.rows) % max(1, one.rows // self.groups) for one in sample.strata)
        return np.concatenate([target, sample.strata[0].rows // self.groups + proposal])

    def result(self) -> Groups:
        """Return the groups, once they are done."""
        assert self.level_pass is not None
        assert self.sample is not None
        last = self.level_pass
        values, failed = last.probabilities, last.failed
        root = last.points.root.reshape(failed.shape)
        roots = [len(np.unique(root[g, failed[g]])) if values[g] else 0 for g in range(self.groups)]
        passed = sum(int(record.passed.sum()) for record in last.levels)
        return Groups(
            values,
            self.entered,
            tuple(roots),
            self.errors + last.error_weight,
            passed * self.size.chains * (LENGTH - 1),
            tuple(self._failures(int(g)) for g in np.flatnonzero(values)),
        )

    def _failures(self, group: int) -> Failures:
        """Return some failures of a group, far apart in its chains, which share its estimate."""
        assert self.level_pass is not None
        last, size = self.level_pass, self.level_pass.shape.samples
        rows = spread(group * size + np.flatnonzero(last.failed[group]), _KEPT)
        tapes, place, counts = np.unique(
            last.points.tape[rows], axis=0, return_index=True, return_counts=True
        )
        rows = rows[place]
        ancestors = np.stack([np.full(len(rows), self.first + group), last.points.root[rows]], axis=1)
        weights = counts / counts.sum() * last.probabilities[group]
        return Failures(tapes, last.points.robustness[rows], 0, weights, ancestors)


def points_of(samples: Sequence[Sample], rows: Integers) -> Points:
    """Return points at rows of samples, counted through; their roots are the rows."""
    different, place = np.unique(rows, return_inverse=True)
    begin, tapes = 0, []
    for sample in samples:
        end = begin + len(sample.error)
        tapes.append(sample.tapes(different[(different >= begin) & (different < end)] - begin))
        begin = end

    def pooled(name: str) -> Any:
        return np.asarray(np.concatenate([getattr(sample, name) for sample in samples])[rows])

    return Points(
        np.concatenate(tapes)[place],
        pooled("score"),
        pooled("violated"),
        pooled("robustness"),
        rows,
        np.zeros(len(rows)),
    )


def _shape(runs: int, chains: int, stage: int) -> PassShape:
    return PassShape(runs, chains, LENGTH, 0, chains, _FLOOR, stage)


def _asked(level_pass: LevelPass) -> Request | None:
    proposal = level_pass.proposal
    return None if proposal is None else Request.replay(proposal)
