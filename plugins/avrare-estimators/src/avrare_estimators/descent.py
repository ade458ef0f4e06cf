"""One way down through the levels, for R runs together: the pilot, or the pass that counts.

A run's first N = C P tapes are fresh. At each level C of the survivors seed chains, and these with the next
P - 1 samples of each chain are the N samples of the next level (subset simulation, Au and Beck 2001;
waste-free SMC, Dau and Chopin 2022). With levels and kernels that were fixed beforehand the product of the
shares is unbiased; a pilot, which sets its own, is off by about levels x (1 - p0) / (p0 N).

Where the system reports weights (noise drawn from q where P is meant) chains follow q, and each share, the
first too, is that of the weights P/q. Weights may be known up to a constant; a share is then a ratio of two
means, off by about (1 + variance of the weights) / N.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare import batch
from avrare.estimation.plan import Plan
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Rollouts
from avrare_estimators.chains import Draw, Info, Kernel, Move, Points
from avrare_estimators.nested_levels import (
    choose_seeds,
    effective_size,
    next_levels,
    relative_weights,
)

_STAGE_OF_LEVEL = 2**17
"""Stages set aside for the steps of a level."""


@dataclass(frozen=True)
class Shape:
    """The size of a pass.

    Attributes:
        runs: R.
        chains: C, of a run.
        length: P, samples of a chain at a level.
        skip: Steps between two samples.
        survivors: Samples that shall lie above the next level.
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
        """N, of a run at a level."""
        return self.chains * self.length


@dataclass(frozen=True)
class Step:
    """A level that was gone through, of all runs; NaN and False for those that had ended.

    Attributes:
        level: (R,).
        going: (R,) the run went through it.
        share: (R,) of the samples that lay above.
        effective: (R,) independent samples that the share is worth.
        known: What the kernel had learnt when the level was done.
        weights: (R,) independent samples that the samples' weights are worth; N where all are the same.
        largest: (R,) share of the largest weight.
    """

    level: Floats
    going: Bools
    share: Floats
    effective: Floats
    known: Any
    weights: Floats
    largest: Floats


@dataclass(frozen=True)
class Descent:
    """A pass under way.

    Attributes:
        plan: The task.
        shape: Its size.
        kernel: How chains move.
        schedule: Levels and kernels to follow; None for a pilot.
        population: (R N) samples of each run's newest level, run by run, then sample by sample of all chains.
        weight: (R,) product of the shares.
        active: (R,) runs that go on.
        undecided: (R,) weight of rollouts that broke down.
        steps: Levels done.
        known: What the kernel has learnt, and what it has seen on the way.
        move: The step in hand, of the chains of all active runs.
        moved: Steps done at this level.
        kept: Samples of this level so far, (A C) each.
        tried: (R,) rollouts of this level.
        broken: (R,) of them, those that broke down.
        fresh: (R N, steps + 1, noise_size) the first tapes, while they are asked for.
    """

    plan: Plan
    shape: Shape
    kernel: Kernel
    schedule: tuple[Step, ...] | None
    population: Points | None
    weight: Floats
    active: Bools
    undecided: Floats
    steps: tuple[Step, ...]
    known: Any
    move: Move | None
    moved: int
    kept: tuple[Points, ...]
    tried: Integers
    broken: Integers
    fresh: Floats | None

    @staticmethod
    def begin(plan: Plan, shape: Shape, kernel: Kernel, schedule: tuple[Step, ...] | None) -> Descent:
        """The first draw."""
        zeros = np.zeros(shape.runs, dtype=np.int64)
        run, own = np.divmod(np.arange(shape.runs * shape.samples), shape.samples)
        draw = Draw(plan.noise, plan.steps, run, shape.stage, own)
        return Descent(
            plan, shape, kernel, schedule, population=None, weight=np.ones(shape.runs),
            active=np.ones(shape.runs, dtype=bool), undecided=np.zeros(shape.runs), steps=(),
            known=kernel.init(shape.runs), move=None, moved=0, kept=(), tried=zeros, broken=zeros,
            fresh=draw.tapes(),
        )  # fmt: skip

    @property
    def proposal(self) -> Floats | None:
        """Tapes (M, steps + 1, noise_size) that want a rollout; None when all runs have ended."""
        if self.fresh is not None:
            return self.fresh
        return self.move.proposal if self.move is not None else None

    @property
    def probabilities(self) -> Floats:
        """(R,) of the levels so far; with a schedule, unbiased."""
        assert self.population is not None
        violated = self.population.violated.reshape(self.shape.runs, -1)
        return np.asarray(self.weight * (self.weights * violated).mean(axis=1))

    @property
    def weights(self) -> Floats:
        """(R, N) weights of the samples of each run's newest level, of mean 1."""
        assert self.population is not None
        return relative_weights(self.population.log_weight.reshape(self.shape.runs, -1))

    def effective(self, hit: Bools) -> Floats:
        """(R,) independent samples that the share of hits (R, N) in the newest level is worth."""
        assert self.population is not None
        if not self.population.log_weight.any():
            if not self.steps:
                return np.full(self.shape.runs, float(self.shape.samples))
            return effective_size(self.samples(hit))
        if not self.steps:  # fresh tapes: each is a chain of its own
            return effective_size(hit[:, None], self.weights[:, None])
        return effective_size(self.samples(hit), self.samples(self.weights))

    def tell(self, rollouts: Rollouts) -> Descent:
        """Go on with what the rollouts have told."""
        if self.fresh is not None:
            return self._drawn(rollouts)
        assert self.move is not None
        waiting = self.move.waiting
        found = Points.of(self.move.proposal, rollouts, self.move.state.root[waiting])
        descent = self._counted(self.move.draw.run[waiting], rollouts.error)
        return replace(descent, move=self.kernel.tell(self.move, found))._onwards()

    def samples(self, values: Any) -> Any:
        """(R, P, C) of an array (R N,) over the population."""
        return values.reshape(self.shape.runs, self.shape.length, self.shape.chains)

    def _drawn(self, rollouts: Rollouts) -> Descent:
        assert self.fresh is not None
        run, own = np.divmod(np.arange(len(self.fresh)), self.shape.samples)
        drawn = Points.of(self.fresh, rollouts, own)
        descent = replace(self._counted(run, rollouts.error), population=drawn, fresh=None)
        return descent._next_level()._onwards()

    def _counted(self, run: Integers, error: Bools) -> Descent:
        tried = self.tried + np.bincount(run, minlength=self.shape.runs)
        broken = self.broken + np.bincount(run, error, minlength=self.shape.runs).astype(np.int64)
        return replace(self, tried=tried, broken=broken)

    def _onwards(self) -> Descent:
        """Until a rollout is wanted: end steps of chains, levels, and the pass."""
        descent = self
        while descent.move is not None and not len(descent.move.waiting):
            descent = descent._step_done()
        return descent

    def _step_done(self) -> Descent:
        assert self.move is not None
        move, shape, known = self.move, self.shape, self.known
        info = Info(move.draw.run, move.accepted, move.work)
        if self.schedule is None:
            known = self.kernel.adapt(known, info)
        watch = getattr(self.kernel, "watch", None)
        if watch is not None:
            known = watch(known, info)
        moved = self.moved + 1
        kept = (*self.kept, move.state) if moved % (shape.skip + 1) == 0 else self.kept
        descent = replace(self, known=known, moved=moved, kept=kept)
        if moved == (shape.length - 1) * (shape.skip + 1):
            return descent._level_done()
        return descent._move(move.state, move.level)

    def _move(self, state: Points, level: Floats) -> Descent:
        """The next step of all active chains begins."""
        shape, runs = self.shape, np.flatnonzero(self.active)
        run = np.repeat(runs, shape.chains)
        stage = shape.stage + len(self.steps) * _STAGE_OF_LEVEL + self.moved + 1
        chain = np.tile(np.arange(shape.chains), len(runs))
        draw = Draw(self.plan.noise, self.plan.steps, run, stage, chain)
        known = self.schedule[len(self.steps) - 1].known if self.schedule is not None else self.known
        return replace(self, move=self.kernel.start(batch.take(known, run), state, level, draw))

    def _level_done(self) -> Descent:
        """The chains' samples are the population of the level."""
        assert self.population is not None
        shape, active = self.shape, int(self.active.sum())
        order = np.arange(active * shape.samples).reshape(shape.length, active, shape.chains)
        new = batch.take(batch.concatenate(self.kept), order.transpose(1, 0, 2).ravel())
        places = np.flatnonzero(np.repeat(self.active, shape.samples))
        population = replace(self.population.updated(places, new), root=self.population.root.copy())
        population.root[places] = new.root
        steps = self.steps
        if self.schedule is None:
            steps = (*steps[:-1], replace(steps[-1], known=self.known))
        return replace(self, population=population, steps=steps, kept=())._next_level()

    def _next_level(self) -> Descent:
        """Set the next level, weigh the runs by who survives it, and let the seeds go on."""
        assert self.population is not None
        shape, population = self.shape, self.population
        undecided = self.undecided + self.weight * self.broken / np.maximum(self.tried, 1)
        level, going = self._level(population)
        above = population.above(np.repeat(level, shape.samples)).reshape(shape.runs, -1)
        weights = self.weights
        share = (weights * above).mean(axis=1)
        weight = np.where(going, self.weight * share, self.weight)
        weight[weight < shape.floor] = 0.0
        step = Step(
            np.where(going, level, np.nan), going, np.where(going, share, np.nan),
            self.effective(above), self.known,
            weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300),
            weights.max(axis=1) / shape.samples,
        )  # fmt: skip
        active = going & (weight > 0.0)
        zeros = np.zeros_like(self.tried)
        descent = replace(
            self, weight=weight, undecided=undecided, active=active, tried=zeros, broken=zeros, moved=0,
            move=None, steps=(*self.steps, step) if going.any() else self.steps,
        )  # fmt: skip
        return descent._seed(level, above) if active.any() else descent

    def _level(self, population: Points) -> tuple[Floats, Bools]:
        """(R,) next levels and (R,) whether there is one."""
        done = len(self.steps)
        if self.schedule is None:
            key = population.key.reshape(self.shape.runs, -1)
            level, more = next_levels(key, self.shape.survivors)
            return level, more & self.active
        if done == len(self.schedule):
            return np.full(self.shape.runs, np.nan), np.zeros(self.shape.runs, dtype=bool)
        step = self.schedule[done]
        return step.level, step.going & self.active

    def _seed(self, level: Floats, above: Bools) -> Descent:
        """Seeds of the active runs, each the first sample of its chain."""
        assert self.population is not None
        shape, runs = self.shape, np.flatnonzero(self.active)
        stage = shape.stage + len(self.steps) * _STAGE_OF_LEVEL
        uniforms = self.plan.noise.choices(runs, stage, 0)
        chosen = choose_seeds(above[runs], shape.chains, uniforms)
        seeds = batch.take(self.population, (runs[:, None] * shape.samples + chosen).ravel())
        descent = replace(self, kept=(seeds,))
        if self.schedule is None:
            own = np.repeat(self.active, shape.samples)
            known = self.kernel.learn(self.known, runs, batch.take(self.population, own), level[runs])
            descent = replace(descent, known=known)
        return descent._move(seeds, np.repeat(level[runs], shape.chains))
