"""Learning of ``smc``: a pilot, stages of the tape proposal, then stages of particles that go further down.

Nothing that is drawn here counts. It ends with a proposal and potentials that are fixed before the first
rollout that does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.estimation.plan.plan import Plan
from avrare.rollout.request import Integers, Request, Rollouts
from avrare_estimators.common.learning.pooled_samples import PooledSamples
from avrare_estimators.common.samples.sampling import PartialSample, Sample
from avrare_estimators.common.samples.sources import TapeSource
from avrare_estimators.common.samples.stages import gain_nothing, is_learnt, is_worthless
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from avrare_estimators.common.weights import effective_size
from avrare_estimators.smc.config import SmcConfig
from avrare_estimators.smc.defended_mixture import DefendedMixture
from avrare_estimators.smc.particles import Course, Particles
from avrare_estimators.smc.potentials import Paths, Potentials, learn

LEARNING_RUN = 2**31
"""Address of the noise of particles that only teach, far from those that count."""
_PILOT_SHARE, _LEARNING_SHARE = 6, 2
"""The pilot takes at most 1 / 6 of the rollouts of a budget, all learning at most half."""


@dataclass(frozen=True)
class Learning:
    """Learning under way.

    Attributes:
        config: The options.
        plan: The task.
        schedule: (K,) steps whose features are learnt from.
        affordable: Rollouts that learning may take.
        pool: Samples of the pilot and of the stages of the proposal.
        mixture: Proposal; None: the target.
        stages: An entry for each stage so far.
        paths: Rollouts to learn potentials from, by stage.
        potentials: Newest potentials.
        task: The stage under way; None: learning has ended.
        spent: Rollouts asked for.
    """

    config: SmcConfig
    plan: Plan
    schedule: Integers
    affordable: int
    pool: PooledSamples
    mixture: TapeMixture | None = None
    stages: tuple[dict[str, Any], ...] = ()
    paths: tuple[Paths, ...] = ()
    potentials: Potentials | None = None
    task: PartialSample | Particles | None = None
    spent: int = 0

    @staticmethod
    def begin(config: SmcConfig, plan: Plan, affordable: int) -> Learning:
        """Begin with the pilot."""
        count = min(config.times, max(plan.steps - 1, 0))
        steps = np.round(plan.steps * np.arange(1, count + 1) / (count + 1)).astype(np.int64)
        schedule = np.unique(steps[(steps > 0) & (steps < plan.steps)])
        empty = Learning(
            config, plan, schedule, affordable // _LEARNING_SHARE, PooledSamples(config.defensive)
        )
        return empty._sample(min(config.pilot, max(2, affordable // _PILOT_SHARE)), None)

    @property
    def pending(self) -> Request | None:
        """The rollouts to run next; None: learning has ended."""
        if isinstance(self.task, Particles):
            return self.task.request()
        return self.task.pending if self.task is not None else None

    def tell(self, rollouts: Rollouts) -> Learning:
        """Take in the rollouts."""
        assert self.task is not None
        task = self.task.tell(rollouts)
        state = replace(self, task=task)
        if isinstance(task, PartialSample):
            return state if task.pending is not None else state._after_sample(task.sample())
        return state._after_particles(task) if task.done else state

    def _sample(self, rows: int, mixture: TapeMixture | None) -> Learning:
        share = self.config.defensive if mixture is not None else 1.0
        source = TapeSource(mixture, tuple(self.schedule.tolist()))
        stage = len(self.pool.samples)
        task = PartialSample.begin(source, self.plan, 0, stage, rows, share, self.config.memory)
        return replace(self, task=task, spent=self.spent + rows)

    @property
    def _stage_rows(self) -> int:
        return max(1, len(self.pool.samples[0].error) // 2)

    @property
    def _affords_stage(self) -> bool:
        return len(self.stages) <= self.config.stages and self.spent + self._stage_rows <= self.affordable

    def _after_sample(self, sample: Sample) -> Learning:
        pool = self.pool.add(replace(sample, features=sample.features[:0]))
        paths = join_stages(self.paths, sample, pool)
        state = replace(self, pool=pool, stages=(*self.stages, pool.describe_stage()), paths=paths)
        # 1. The proposal on the tape, by the stages of `is`.
        hopeless = not len(pool.elite[0])
        learnt = is_learnt(state.stages, self.config.stages) or gain_nothing(state.stages)
        learnt = learnt or self.config.proposal == "none"
        if not (hopeless or learnt) and state._affords_stage:
            state = replace(state, pool=pool.fit_proposal())
            return state._sample(state._stage_rows, state.pool.mixtures[-1])
        if not (self.config.proposal == "none" or hopeless or is_worthless(state.stages[-1])):
            state = replace(state, mixture=pool.blend_proposals())
        return state._learn_potentials()

    def _after_particles(self, task: Particles) -> Learning:
        paths = task.paths()
        contributions = paths.weights * paths.violated
        entry = {
            "rollouts": task.runs * task.course.particles + task.copies,
            "failures": int(paths.violated.sum()),
            "probability": float(contributions.mean()) if len(contributions) else 0.0,
            "level_probability": float(self.potentials.chances[-1]) if self.potentials is not None else None,
            "reached": effective_size(contributions) > 1.0,
            "level": None,
        }
        state = replace(self, stages=(*self.stages, entry), paths=(*self.paths, paths))
        return state._learn_potentials()

    def _learn_potentials(self) -> Learning:
        # 2. Potentials from all rollouts so far; while they end short of failure, particles go further down.
        if not len(self.schedule):
            return replace(self, task=None)
        seed = (self.plan.noise.seed, LEARNING_RUN, len(self.stages))
        potentials, before = learn(self.paths, seed), self.potentials
        state = replace(self, potentials=potentials or before, task=None)
        if potentials is None or potentials.reached or not state._affords_stage:
            return state
        # further stages lead nowhere
        if before is not None and potentials.chances[-1] > 0.7 * before.chances[-1]:
            return state
        rows = state._stage_rows
        course = Course(self.plan, rows, state.law, self.schedule, potentials, 0, learning=True)
        task = Particles.begin(course, LEARNING_RUN + len(self.stages), 1)
        return replace(state, task=task, spent=self.spent + rows)

    @property
    def law(self) -> DefendedMixture | None:
        """Law of the tapes of particles; None: the target's."""
        if self.mixture is None:
            return None
        return DefendedMixture(self.mixture, self.config.defensive)


def join_stages(paths: tuple[Paths, ...], sample: Sample, pool: PooledSamples) -> tuple[Paths, ...]:
    """Return the rollouts of all stages as one, with the weights that they have in the pool."""
    features = np.concatenate([*(stage.features for stage in paths), sample.features])
    samples = pool.samples

    def join(name: str) -> Any:
        return np.concatenate([getattr(each, name) for each in samples])

    weights = np.where(join("error"), 0.0, pool.weights)
    return (Paths(features, join("score"), join("violated"), weights, np.arange(len(weights))),)
