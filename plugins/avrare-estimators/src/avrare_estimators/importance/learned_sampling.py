"""Importance sampling whose proposal on the noise tape is learnt: pilot, stages, then a fresh sample.

Every number of the proposal is fixed before the first row that counts is drawn. The pilot and the stages
choose it, decide how many rows are worth drawing, and are then left out of the estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from avrare.estimation.cost_forecast import CostForecast
from avrare.estimation.plan import GaveUp, Info, Plan
from avrare.estimation.result import Result
from avrare.rollout.problem import Problem
from avrare_estimators.config import IsConfig
from avrare_estimators.cost import affordable_rollouts
from avrare_estimators.importance.coverage import find_coverage_doubts
from avrare_estimators.importance.importance_sampling import SamplingState, WeightedSampler
from avrare_estimators.importance.lessons import Lessons, is_learnt, is_stuck, is_worthless
from avrare_estimators.importance.proposal_file import FILE, ProposalFile, described
from avrare_estimators.importance.sampling import PartialSample, Sample, TapeSource, wave_rows
from avrare_estimators.importance.tape_mixture import TapeMixture, blend
from avrare_estimators.importance.words import NoiseNames, describe_failures
from avrare_estimators.looks import Looks
from avrare_estimators.weights import stratified_variance

_PILOT_SHARE, _LEARNING_SHARE = 6, 2
"""The pilot takes at most 1 / 6 of the rollouts of a run, all learning at most half."""
_LEAST_LOOK = 1000
_WORTHLESS = "learning found no proposal that beats Monte Carlo by a factor of two"

_UNREACHED = "learning did not reach a failure"


@dataclass(frozen=True)
class LearnedState(SamplingState):
    """State of runs that learn.

    Attributes:
        lessons: Stages of the present run.
        looks: Numbers of rows at which the final sample may end; None while learning.
        final: Parts of the final sample so far.
    """

    lessons: Lessons = field(default_factory=lambda: Lessons(0.0))
    looks: Looks | None = None
    final: tuple[Sample, ...] = ()


class LearnedSampling(WeightedSampler):
    """Estimator ``is`` with ``proposal: learned``."""

    name = "is"
    config: IsConfig
    names: NoiseNames | None = None

    def __init__(self, config: IsConfig) -> None:
        self.config = config
        self.file = ProposalFile.read(config.learned) if config.learned is not None else None

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem unchanged; its noise names are for the report."""
        self.names = NoiseNames.of(problem)
        return problem

    def init(self, plan: Plan) -> tuple[LearnedState, Info]:
        """Return the state before the first rollout, and what to show."""
        rollouts = self._rows(plan)
        most = rollouts * self.config.runs
        info = Info(goal=most)
        if self.config.relative_error is not None:
            info = Info(forecast=CostForecast("rollouts", 0.0, most))
        return self._begin_run(LearnedState(plan, rollouts, TapeSource(None), tally=info)), info

    def _rows(self, plan: Plan) -> int:
        return affordable_rollouts(plan, self.config.rollouts, self.config.runs, stages=1)

    def estimate(self, state: LearnedState) -> list[Result]:  # type: ignore[override]
        """Return the estimate from the final samples, what was learnt, and the file of the proposal."""
        assert self.names is not None
        result = super().estimate(state)[0]
        samples = [run.sample for run in state.finished]
        told = {
            "pilot_rollouts": sum(stage["rollouts"] for run in state.finished for stage in run.stages),
            "learnt": describe_failures(samples, self.names),
        }
        mixtures = [mixture for sample in samples if (mixture := mixture_of(sample)) is not None]
        artifacts = {}
        if not mixtures:
            told["note"] = f"{_WORTHLESS}: the rollouts that count are drawn from the target"
        else:
            several = len(mixtures) > 1
            frozen = blend(mixtures, [1.0 / len(mixtures)] * len(mixtures)) if several else mixtures[0]
            told["proposal"] = frozen.digest
            artifacts = {FILE: described(frozen, self.names)}
        interval_at = result.interval_at
        if self.config.relative_error is not None and state.looks is not None:
            rows = len(samples[0].error)
            interval_at = state.looks.interval(rows, interval_at)
            told["goal_reached"] = bool(result.relative_error <= self.config.relative_error)
        diagnostics = {**result.diagnostics, **told}
        return [replace(result, interval_at=interval_at, diagnostics=diagnostics, artifacts=artifacts)]

    def _begin_run(self, state: SamplingState) -> LearnedState:
        assert isinstance(state, LearnedState)
        state = replace(state, lessons=Lessons(self.config.defensive), looks=None, final=())
        if self.file is not None:
            return self._begin_final(state, self.file.find(state.plan))
        return self._learn(state)

    def _learn(self, state: LearnedState) -> LearnedState:
        # 1. A pilot from the target, then stages from what the stages before have taught.
        stage, mixtures = len(state.stages), state.lessons.mixtures
        rows = self._stage_rows(state, stage)
        target_rows = round(self.config.defensive * rows) if stage else rows
        source = TapeSource(mixtures[-1] if mixtures else None)
        wave = wave_rows(state.plan, self.config.memory)
        task = PartialSample.begin(source, state.plan, state.run, stage, rows, target_rows, wave)
        return replace(state, source=source, task=task)

    def _stage_rows(self, state: LearnedState, stage: int) -> int:
        pilot = max(2, min(self.config.pilot, state.rollouts // _PILOT_SHARE))
        return pilot if stage == 0 else max(1, pilot // 2)

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        assert isinstance(state, LearnedState)
        if state.looks is not None:
            return self._look(replace(state, final=(*state.final, sample)))
        lessons = state.lessons.add(sample)
        state = replace(state, lessons=lessons, stages=(*state.stages, lessons.report()))
        if self._learnt(state):
            # 2. What the stages have seen decides from where to draw, once and for all.
            plain = is_worthless(state.stages[-1])
            if (plain or not state.stages[-1]["reached"]) and not self.config.fall_back:
                reason = _WORTHLESS if plain else _UNREACHED
                raise GaveUp.after(state.tally, reason, "leave fall_back true, or use another estimator")
            return self._begin_final(state, None if plain else lessons.final())
        return self._learn(replace(state, lessons=lessons.learn()))

    def _learnt(self, state: LearnedState) -> bool:
        done = sum(stage["rollouts"] for stage in state.stages)
        affordable = done + self._stage_rows(state, 1) <= state.rollouts // _LEARNING_SHARE
        hopeless = not len(state.lessons.elite[0])
        hopeless |= not self.config.fall_back and is_stuck(state.stages)
        return hopeless or not affordable or is_learnt(state.stages, self.config.stages)

    def _begin_final(self, state: LearnedState, mixture: TapeMixture | None) -> LearnedState:
        source, goal = TapeSource(mixture), self.config.relative_error
        learning = sum(len(sample.error) for sample in state.samples)
        most = max(2, int((1.0 - self.config.check) * state.rollouts) - learning)
        first = most
        if goal is not None:
            variance = state.lessons.expected_variance(mixture)
            first = min(most, max(_LEAST_LOOK, int((variance or 0.0) / goal**2 / 2.0)))
        looks = Looks.until(goal, first, most)
        return self._draw(replace(state, source=source, looks=looks), looks.runs[0])

    def _look(self, state: LearnedState) -> SamplingState:
        # 3. The final sample ends at the first look at which it is exact enough.
        assert state.looks is not None
        sample = Sample.join(state.final)
        more = state.looks.missing(len(sample.error), lambda: relative_error(sample))
        if more:
            return self._draw(state, more)
        learning = state.samples[: len(state.samples) - len(state.final)]
        return super()._sample_complete(replace(state, samples=(*learning, sample)), sample)

    def _draw(self, state: LearnedState, rows: int) -> LearnedState:
        assert isinstance(state.source, TapeSource)
        plain = state.source.mixture is None
        target_rows = rows if plain else round(self.config.defensive * rows)
        stage = len(state.stages) + len(state.final)
        wave = wave_rows(state.plan, self.config.memory)
        task = PartialSample.begin(state.source, state.plan, state.run, stage, rows, target_rows, wave)
        return replace(state, task=task)

    def _doubts(self, state: SamplingState) -> dict[str, str]:
        assert isinstance(state, LearnedState)
        return find_coverage_doubts(state.lessons, state.samples[-1])


def relative_error(sample: Sample) -> float:
    """Return the standard error of a sample's estimate over the estimate; infinite without a failure."""
    values = np.where(sample.violated, np.exp(sample.log_weights), 0.0)
    mean = float(values.mean())
    return math.sqrt(stratified_variance(values / mean, sample.target_rows)) if mean else math.inf


def mixture_of(sample: Sample) -> TapeMixture | None:
    """Return the proposal of a final sample; None where it was drawn from the target."""
    assert isinstance(sample.source, TapeSource)
    return sample.source.mixture
