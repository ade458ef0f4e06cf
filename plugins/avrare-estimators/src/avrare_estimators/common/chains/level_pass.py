"""Level pass: one descent through the nested levels, for R runs together; the pilot, or the pass that counts.

A run's first N = C P tapes are fresh. At each level C of the survivors seed chains, and these with the next
P - 1 samples of each chain are the N samples of the next level (subset simulation, Au and Beck 2001;
waste-free SMC, Dau and Chopin 2022). With levels and kernels that were fixed beforehand the product of the
shares is unbiased; a pilot, which sets its own, is off by about levels x (1 - p0) / (p0 N).

Where the system reports weights (noise drawn from q where P is meant) chains follow q, and each share, the
first too, is that of the weights P/q. Weights may be known up to a constant; a share is then a ratio of two
means, off by about (1 + variance of the weights) / N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.estimation.plan.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Rollouts
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, StepOutcome
from avrare_estimators.common.chains.levels import (
    choose_seeds,
    effective_samples,
    next_levels,
    relative_weights,
)

_STAGES_PER_LEVEL = 2**17
"""Addresses set aside for the steps of a level."""


@dataclass(frozen=True, kw_only=True)
class PassShape:
    """The size of a pass.

    Attributes:
        runs: R.
        chains: C, chains of a run.
        length: P, samples of a chain at a level.
        skip: Number of steps between two samples.
        survivors: Number of samples that shall lie above the next level.
        floor: A run ends once its weight falls below.
        stage: Address of the first draw.
    """

    runs: int
    chains: int
    length: int
    skip: int
    survivors: int
    floor: float
    stage: int

    @property
    def samples(self) -> int:
        """N, samples of a run at a level."""
        return self.chains * self.length

    @property
    def moves(self) -> int:
        """Steps of all chains of a run at a level."""
        return self.chains * (self.length - 1) * (self.skip + 1)


@dataclass(frozen=True)
class LevelRecord:
    """A level that runs have passed; NaN and False for those that had ended.

    Attributes:
        level: (R,) score of the level.
        passed: (R,) the run passed it.
        share: (R,) share of the samples that lay above.
        effective: (R,) independent samples that would give the share as accurately.
        tuning: Tuning of the kernel when the level was done.
        weight_size: (R,) effective size of the samples' weights; N where all are equal.
        largest_weight: (R,) share of the largest weight.
    """

    level: Floats
    passed: Bools
    share: Floats
    effective: Floats
    tuning: Any
    weight_size: Floats
    largest_weight: Floats

    @staticmethod
    def missing(runs: int) -> LevelRecord:
        """Return the record of runs that had all ended before."""
        none = np.full(runs, np.nan)
        return LevelRecord(none, np.zeros(runs, dtype=bool), none, none, (), none, none)


@dataclass(frozen=True)
class LevelPass:
    """A pass under way.

    Attributes:
        plan: The task.
        shape: Size of the pass.
        kernel: Kernel that moves the chains.
        schedule: Levels and kernels to follow; None for a pilot.
        weight: (R,) product of the shares.
        active: (R,) runs that go on.
        error_weight: (R,) weight of rollouts that broke down.
        tuning: Tuning of the kernel, with statistics of its steps so far.
        rollouts: (R,) rollouts of this level.
        errors: (R,) rollouts of this level that broke down.
        levels: Levels passed.
        population: (R N) samples of each run's newest level, run by run, then sample by sample of all chains.
        move: The step under way, of the chains of all active runs.
        steps: Number of steps done at this level.
        samples: Samples of this level so far, (A C) each.
        fresh: (R N, steps + 1, noise_size) the first tapes, while they are asked for.
        most: Largest number of levels: a run that comes so far ends with its share of failures.
        common: All runs of a pilot pass the same levels, those of all their samples: its bias is that of one
            large run.
    """

    plan: Plan
    shape: PassShape
    kernel: Kernel
    schedule: tuple[LevelRecord, ...] | None
    weight: Floats
    active: Bools
    error_weight: Floats
    tuning: Any
    rollouts: Integers
    errors: Integers
    levels: tuple[LevelRecord, ...] = ()
    population: Points | None = None
    move: Move | None = None
    steps: int = 0
    samples: tuple[Points, ...] = ()
    fresh: Floats | None = None
    most: float = math.inf
    common: bool = False

    @staticmethod
    def begin(
        plan: Plan,
        shape: PassShape,
        kernel: Kernel,
        schedule: tuple[LevelRecord, ...] | None,
        most: float = math.inf,
    ) -> LevelPass:
        """Draw the first tapes (step 1 of ``_next_level``)."""
        run, sample = np.divmod(np.arange(shape.runs * shape.samples), shape.samples)
        draw = Draw(plan.noise, plan.steps, run, shape.stage, sample)
        empty = LevelPass._of_weight(plan, shape, kernel, schedule, np.ones(shape.runs), most)
        return replace(empty, fresh=draw.tapes())

    @staticmethod
    def _of_weight(
        plan: Plan,
        shape: PassShape,
        kernel: Kernel,
        schedule: tuple[LevelRecord, ...] | None,
        weight: Floats,
        most: float,
    ) -> LevelPass:
        none = np.zeros(shape.runs, dtype=np.int64)
        tuning, errors = kernel.init(shape.runs), np.zeros(shape.runs)
        return LevelPass(
            plan, shape, kernel, schedule, weight, weight > 0.0, errors, tuning, none, none, most=most
        )

    def without_tapes(self) -> LevelPass:
        """Return this ended pass without its tapes, which may be large."""
        return replace(self, population=replace(self.points, tape=self.points.tape[:, :0]))

    def join(self, other: LevelPass) -> LevelPass:
        """Return the runs of this ended pass and then those of another, both without tapes."""
        both, tunings = (self, other), [half.tuning for half in (self, other) if half.tuning is not None]
        names = ("weight", "active", "error_weight", "rollouts", "errors")
        arrays: Any = {name: np.concatenate([getattr(half, name) for half in both]) for name in names}
        return replace(
            self,
            **arrays,
            shape=replace(self.shape, runs=self.shape.runs + other.shape.runs),
            tuning=batch.concatenate(tunings) if tunings else None,
            population=batch.concatenate([half.points for half in both]),
            levels=tuple(
                batch.concatenate(
                    [
                        replace(record, tuning=()) if record else LevelRecord.missing(half.shape.runs)
                        for record, half in zip(pair, both, strict=True)
                    ]
                )
                for pair in zip_longest(self.levels, other.levels)
            ),
        )

    @staticmethod
    def begin_from(plan: Plan, shape: PassShape, kernel: Kernel, points: Points, share: Floats) -> LevelPass:
        """Begin a pilot of common levels at points (R N) above levels of probability ``share`` (R,)."""
        empty = LevelPass._of_weight(plan, shape, kernel, None, share, math.inf)
        return replace(empty, population=points, common=True)._next_level()

    @property
    def proposal(self) -> Floats | None:
        """Tapes (M, steps + 1, noise_size) that want a rollout; None when all runs have ended."""
        if self.fresh is not None:
            return self.fresh
        return self.move.proposal if self.move is not None else None

    @property
    def points(self) -> Points:
        """The population, once the first rollouts are in."""
        assert self.population is not None
        return self.population

    @property
    def failed(self) -> Bools:
        """(R, N) the sample of the newest level fails."""
        return self.points.violated.reshape(self.shape.runs, -1)

    @property
    def probabilities(self) -> Floats:
        """(R,) weight times the share of failures; with a schedule, unbiased."""
        return np.asarray(self.weight * (self.weights * self.failed).mean(axis=1))

    @property
    def weighted(self) -> bool:
        """The system reports weights."""
        return bool(self.points.log_weight.any())

    @property
    def weights(self) -> Floats:
        """(R, N) weights of the samples of each run's newest level, of mean 1."""
        return relative_weights(self.points.log_weight.reshape(self.shape.runs, -1))

    def effective(self, hit: Bools) -> Floats:
        """Return the independent samples (R,) that the share of hits (R, N) in the newest level is worth."""
        if not self.weighted:
            if not self.levels:
                return np.full(self.shape.runs, float(self.shape.samples))
            return effective_samples(self.by_chain(hit))
        if not self.levels:  # fresh tapes: each is a chain of its own
            return effective_samples(hit[:, None], self.weights[:, None])
        return effective_samples(self.by_chain(hit), self.by_chain(self.weights))

    def by_chain(self, values: Any) -> Any:
        """Return an array (R N,) over the population as (R, P, C)."""
        return values.reshape(self.shape.runs, self.shape.length, self.shape.chains)

    def tell(self, rollouts: Rollouts) -> LevelPass:
        """Continue until further rollouts are wanted or all runs have ended."""
        if self.fresh is not None:
            run, sample = np.divmod(np.arange(len(self.fresh)), self.shape.samples)
            drawn = Points.of(self.fresh, rollouts, sample)
            after = replace(self._count(run, rollouts.error), population=drawn, fresh=None)._next_level()
        else:
            assert self.move is not None
            waiting = self.move.waiting
            points = Points.of(self.move.proposal, rollouts, self.move.state.root[waiting])
            after = self._count(self.move.draw.run[waiting], rollouts.error)
            after = replace(after, move=self.kernel.tell(self.move, points))
        while after.move is not None and not len(after.move.waiting):
            after = after._step_done()
        return after

    def _count(self, run: Integers, error: Bools) -> LevelPass:
        rollouts = self.rollouts + np.bincount(run, minlength=self.shape.runs)
        errors = self.errors + np.bincount(run, error, minlength=self.shape.runs).astype(np.int64)
        return replace(self, rollouts=rollouts, errors=errors)

    def _next_level(self) -> LevelPass:
        # 1. All N samples of a run are there: fresh ones, or those of the last level's chains.
        shape, population, weights = self.shape, self.points, self.weights
        error_weight = self.error_weight + self.weight * self.errors / np.maximum(self.rollouts, 1)
        # 2. The next level: an order statistic of the samples, or that of the schedule.
        level, passed = self._level(population)
        above = population.above(np.repeat(level, shape.samples)).reshape(shape.runs, -1)
        # 3. Multiply the weight by the share that lies above (stl-ess, Eq. 7).
        share = (weights * above).mean(axis=1)
        weight = np.where(passed, self.weight * share, self.weight)
        weight[weight < shape.floor] = 0.0
        record = LevelRecord(
            np.where(passed, level, np.nan),
            passed,
            np.where(passed, share, np.nan),
            self.effective(above),
            self.tuning,
            weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300),
            weights.max(axis=1) / shape.samples,
        )
        active = passed & (weight > 0.0)
        zeros = np.zeros_like(self.rollouts)
        after = replace(
            self,
            weight=weight,
            error_weight=error_weight,
            active=active,
            rollouts=zeros,
            errors=zeros,
            steps=0,
            move=None,
            levels=(*self.levels, record) if passed.any() else self.levels,
        )
        return after._seed(level, above) if active.any() else after

    def _level(self, population: Points) -> tuple[Floats, Bools]:
        done = len(self.levels)
        if done >= self.most or (self.schedule is not None and done == len(self.schedule)):
            return np.full(self.shape.runs, np.nan), np.zeros(self.shape.runs, dtype=bool)
        if self.schedule is None:
            key = population.key.reshape(self.shape.runs, -1)
            if not self.common:
                level, more = next_levels(key, self.shape.survivors)
                return level, more & self.active
            pooled = key[self.active].reshape(1, -1)
            level, more = next_levels(pooled, self.shape.survivors * int(self.active.sum()))
            return np.repeat(level, len(key)), more & self.active
        record = self.schedule[done]
        return record.level, record.passed & self.active

    def _seed(self, level: Floats, above: Bools) -> LevelPass:
        # 4. Choose a seed among the survivors for each chain: its first sample of the level.
        shape, runs = self.shape, np.flatnonzero(self.active)
        stage = shape.stage + len(self.levels) * _STAGES_PER_LEVEL
        uniforms = self.plan.noise.choices(runs, stage, 0)
        chosen = choose_seeds(above[runs], shape.chains, uniforms)
        seeds = batch.take(self.points, (runs[:, None] * shape.samples + chosen).ravel())
        return replace(self, samples=(seeds,))._begin_step(seeds, np.repeat(level[runs], shape.chains))

    def _begin_step(self, state: Points, level: Floats) -> LevelPass:
        # 5. Move all chains of the active runs by a step of the kernel.
        shape, runs = self.shape, np.flatnonzero(self.active)
        run = np.repeat(runs, shape.chains)
        stage = shape.stage + len(self.levels) * _STAGES_PER_LEVEL + self.steps + 1
        chain = np.tile(np.arange(shape.chains), len(runs))
        draw = Draw(self.plan.noise, self.plan.steps, run, stage, chain)
        tuning = self.schedule[len(self.levels) - 1].tuning if self.schedule is not None else self.tuning
        return replace(self, move=self.kernel.start(batch.take(tuning, run), state, level, draw))

    def _step_done(self) -> LevelPass:
        assert self.move is not None
        move, shape, tuning = self.move, self.shape, self.tuning
        outcome = StepOutcome(move.draw.run, move.accepted, move.work)
        if self.schedule is None:
            tuning = self.kernel.adapt(tuning, outcome)
        tuning = self.kernel.watch(tuning, outcome)
        steps = self.steps + 1
        samples = (*self.samples, move.state) if steps % (shape.skip + 1) == 0 else self.samples
        after = replace(self, tuning=tuning, steps=steps, samples=samples)
        if steps * shape.chains == shape.moves:
            return after._level_done()
        return after._begin_step(move.state, move.level)

    def _level_done(self) -> LevelPass:
        # 6. The chains' samples are the population of the level; go on with step 1.
        shape, chains = self.shape, np.arange(self.shape.chains)
        first = np.flatnonzero(self.active)[:, None] * shape.samples
        places = [(first + k * shape.chains + chains).ravel() for k in range(shape.length)]
        population = self.points.replace_rows(places, self.samples)
        levels = self.levels
        if self.schedule is None:
            levels = (*levels[:-1], replace(levels[-1], tuning=self.tuning))
        return replace(self, population=population, levels=levels, samples=())._next_level()
