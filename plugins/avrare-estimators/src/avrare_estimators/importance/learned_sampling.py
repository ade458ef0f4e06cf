"""Importance sampling whose proposal on the noise tape is learnt: pilot, stages, then a fresh sample.

Nothing that is drawn while learning counts. The final sample has a first part, which decides how large the
second must be; the share of each in the estimate is fixed before, so that their sum is unbiased.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from avrare.estimation.plan.plan import CostForecast, GaveUp, Info, Plan
from avrare.estimation.result.note import Note, describe_missed_goal, describe_precision
from avrare.estimation.result.result import Result
from avrare.rollout.problem import Problem
from avrare.stack.part_checks import find_noise_names
from avrare_estimators.common.cost import affordable_rollouts
from avrare_estimators.common.learning.pooled_samples import PooledSamples, require_noise
from avrare_estimators.common.samples.checked_sample import CheckedSample
from avrare_estimators.common.samples.cross_check import rollouts_to_vouch
from avrare_estimators.common.samples.sampling import PartialSample, Sample, failing_weights
from avrare_estimators.common.samples.scale_annealing import ROLLOUTS_TO_VOUCH, can_anneal
from avrare_estimators.common.samples.sources import TapeSource
from avrare_estimators.common.samples.stages import (
    gain_nothing,
    has_reached,
    is_learnt,
    is_stuck,
    is_worthless,
)
from avrare_estimators.common.samples.weighted_sampler import SamplingState, WeightedSampler
from avrare_estimators.common.tapes.tail_atoms import tail_atoms, with_tail_atoms
from avrare_estimators.common.tapes.tape_mixture import TapeMixture, blend
from avrare_estimators.common.weights import stratified_variance
from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.proposal_file import FILE, ProposalFile, to_entry

_PILOT_SHARE, _LEARNING_SHARE, _LEARNING_SHARE_OF_GOAL = 6, 2, 3
"""The pilot takes at most 1 / 6 of the rollouts of a run, all learning at most half; where an error is asked
for, a third."""
_TARGET_OF_PILOT = 0.5
"""Share of the pilot that is drawn from the target."""
_LEAST_ROWS, _MARGIN = 3000, 1.5
"""Rows of each part of the final sample at least, and the factor above those that are forecast: few failures
mostly show too little of their variance."""
_FIRST_SHARE = 1.0 / 3.0
"""Share that the first part of the final sample has in the estimate."""
_LEAST_LEFT = 0.05
"""Variance that the rest may at least have, over that of the first part."""
_LAST_STAGES = 2.0
"""Stages in whose cost the estimate can be ended: then learning more does not pay."""
_WORTHLESS = "learning found no proposal that beats Monte Carlo by a factor of two"

_UNREACHED = "learning did not reach a failure"


@dataclass(frozen=True)
class LearnedState(SamplingState):
    """State of runs that learn.

    Attributes:
        pool: Stages of the present run.
        shares: Share of the estimate that each part of the final sample has, the present one included; empty
            while learning.
    """

    pool: PooledSamples = field(default_factory=lambda: PooledSamples(0.0))
    shares: tuple[float, ...] = ()

    @property
    def rows(self) -> int:
        """Rollouts of this run, except for a cross-check."""
        return sum(len(sample.error) for sample in self.samples)


class LearnedSampling(WeightedSampler):
    """Estimator ``is`` with ``proposal: learned``."""

    name = "is"
    config: IsConfig
    names: tuple[str, ...] = ()

    def __init__(self, config: IsConfig, file: ProposalFile | None = None) -> None:
        self.config = config
        self.file = file

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem unchanged; its noise names are for the file."""
        self.names = find_noise_names(problem.system)
        return problem

    def init(self, plan: Plan) -> tuple[LearnedState, Info]:
        """Return the state before the first rollout, and its progress."""
        require_noise(plan)
        rollouts = self._rows(plan)
        most = rollouts * self.config.runs
        info = Info(goal=most)
        if self.config.relative_error is not None:
            info = Info(forecast=CostForecast("rollouts", 0.0, most))
        return self._begin_run(LearnedState(plan, rollouts, TapeSource(None), tally=info)), info

    def _rows(self, plan: Plan) -> int:
        return affordable_rollouts(plan, self.config.most_rollouts, self.config.runs, stages=1)

    def estimate(self, state: LearnedState) -> list[Result]:  # type: ignore[override]
        """Return the estimate from the final samples, and the file of the proposal."""
        result = super().estimate(state)[0]
        samples = [run.sample for run in state.finished]
        diagnostics: dict[str, object] = {
            "learning_rollouts": sum(stage["rollouts"] for run in state.finished for stage in run.stages)
        }
        notes: list[Note] = []
        mixtures = [mixture for sample in samples if (mixture := mixture_of(sample)) is not None]
        artifacts = {}
        if not mixtures:
            notes.append(
                Note("learning", f"The rollouts that count are drawn from the target: {_WORTHLESS}.")
            )
        else:
            several = len(mixtures) > 1
            learned = [mixture.learned or mixture for mixture in mixtures]
            frozen = blend(learned, [1.0 / len(learned)] * len(learned)) if several else learned[0]
            diagnostics["proposal"] = frozen.digest
            artifacts = {FILE: to_entry(frozen, self.names)}
        if self.config.relative_error is not None:
            diagnostics["goal_reached"] = bool(result.relative_error <= self.config.relative_error)
            # sizes are forecasts: an error a quarter above the goal is near enough
            if not result.relative_error <= 1.25 * self.config.relative_error:
                progress = describe_precision(result.probability, result.relative_error)
                notes.insert(0, describe_missed_goal(result.rollouts, progress))
        complete = replace(
            result,
            diagnostics=result.diagnostics | diagnostics,
            artifacts=artifacts,
            notes=(*result.notes, *notes),
        )
        return [complete]

    def _begin_run(self, state: SamplingState) -> LearnedState:
        assert isinstance(state, LearnedState)
        plan = state.plan
        pool = PooledSamples(self.config.target_share, tail=tail_atoms(plan.steps, plan.noise.noise_size))
        state = replace(state, pool=pool, shares=())
        if self.file is not None:
            return self._begin_final(state, with_tail_atoms(self.file.find(state.plan)))
        return self._learn(state)

    def _learn(self, state: LearnedState) -> LearnedState:
        # 1. A pilot from the target and from tail atoms, then stages from what the stages before have taught.
        stage, source = len(state.stages), TapeSource(state.pool.proposal)
        rows = self._stage_rows(state, stage)
        share = self.config.target_share if stage else _TARGET_OF_PILOT
        task = PartialSample.begin(source, state.plan, state.run, stage, rows, share, self.config.memory)
        return replace(state, source=source, task=task)

    def _affordable(self, state: LearnedState) -> int:
        return max(2, int((1.0 - self.config.check) * state.rollouts) - state.rows)

    def _stage_rows(self, state: LearnedState, stage: int) -> int:
        pilot = max(2, min(self.config.pilot, state.rollouts // _PILOT_SHARE))
        return pilot if stage == 0 else max(1, pilot // 2)

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        assert isinstance(state, LearnedState)
        if state.shares == (_FIRST_SHARE,):
            return self._draw_rest(state, sample)
        if state.shares:
            return self._check(state, sample)
        pool = state.pool.add(sample)
        return self._after_stage(replace(state, pool=pool, stages=(*state.stages, pool.describe_stage())))

    def _after_stage(self, state: LearnedState) -> LearnedState:
        if self._has_learnt(state):
            # 2. What the stages have seen decides from where to draw, once and for all.
            last, plain = state.stages[-1], is_worthless(state.stages[-1])
            if (plain or not has_reached(last)) and not self.config.fall_back:
                reason = _WORTHLESS if plain and not is_stuck(state.stages) else _UNREACHED
                raise GaveUp.after(state.tally, reason, "leave fall_back true, or use another estimator")
            return self._begin_final(state, None if plain else state.pool.blend_proposals())
        return self._learn(replace(state, pool=state.pool.fit_proposal()))

    def _has_learnt(self, state: LearnedState) -> bool:
        done = sum(stage["rollouts"] for stage in state.stages)
        share = _LEARNING_SHARE if self.config.relative_error is None else _LEARNING_SHARE_OF_GOAL
        affordable = done + self._stage_rows(state, 1) <= state.rollouts // share
        hopeless = not len(state.pool.elite[0])
        hopeless |= not self.config.fall_back and is_stuck(state.stages)
        ended = is_learnt(state.stages, self.config.stages) or gain_nothing(state.stages)
        return hopeless or not affordable or self._ends(state) or ended

    def _ends(self, state: LearnedState) -> bool:
        """Return whether the estimate is nearly done: another stage would cost more than it saves."""
        shown = state.pool.fresh_variance
        if self.config.relative_error is None or shown is None or not state.pool.mixtures:
            return False
        if not has_reached(state.stages[-1]):
            return False
        return shown / self.config.relative_error**2 < _LAST_STAGES * self._stage_rows(state, 1)

    def _begin_final(self, state: LearnedState, mixture: TapeMixture | None) -> LearnedState:
        """Begin the final sample: all of it, or where an error is asked for a first part."""
        state, goal = replace(state, source=TapeSource(mixture)), self.config.relative_error
        if goal is None:
            return self._draw(state, math.inf, 1.0)
        variance = state.pool.expected_variance(mixture)
        if mixture is None:
            return self._draw(state, math.inf if variance is None else variance / goal**2, 1.0)
        if state.stages:
            variance = max(variance or 0.0, state.pool.fresh_variance or 0.0)
        return self._draw(state, (variance or 0.0) / goal**2 / 2.0, _FIRST_SHARE)

    def _draw_rest(self, state: LearnedState, first: Sample) -> LearnedState:
        # 3. The rest of the final sample is as large as the first part asks for. Its share is fixed.
        assert self.config.relative_error is not None
        weights, share = failing_weights(first), 1.0 - _FIRST_SHARE
        mean = float(weights.mean())
        if not mean:
            return self._draw(state, math.inf, share)
        variance = _MARGIN * stratified_variance(weights / mean, first.target_rows)
        goal = max(self.config.relative_error**2 - _FIRST_SHARE**2 * variance, _LEAST_LEFT * variance)
        return self._draw(state, share**2 * variance * len(weights) / goal, share)

    def _draw(self, state: LearnedState, wanted: float, share: float) -> LearnedState:
        assert isinstance(state.source, TapeSource)
        # The parts to come get as much of what is left as their shares of the estimate.
        most = max(2.0, self._affordable(state) * share / (1.0 - sum(state.shares)))
        rows = int(min(most, max(_LEAST_ROWS, wanted)))
        of_target = 1.0 if state.source.mixture is None else self.config.target_share
        stage, memory = len(state.samples), self.config.memory
        sample = PartialSample.begin(state.source, state.plan, state.run, stage, rows, of_target, memory)
        state = replace(state, task=sample, shares=(*state.shares, share))
        if of_target == 1.0 or share == _FIRST_SHARE or not state.samples:
            return state
        check = self._begin_check(state, rows)
        return state if check is None else replace(state, task=CheckedSample(sample, check))

    def _list_counted_samples(self, state: SamplingState) -> tuple[tuple[float, Sample], ...]:
        assert isinstance(state, LearnedState)
        return tuple(zip(state.shares[:-1], state.samples[-len(state.shares) : -1], strict=True))

    def _check_rollouts(self, state: SamplingState, rows: int) -> int:
        """Return the rollouts of the cross-check; with a target error, at least those of a conclusive one.

        Such a sample is as small as the error allows, and a share of it is too small for the climb.
        """
        share = super()._check_rollouts(state, rows)
        if self.config.relative_error is None or not self.config.check:
            return share
        assert isinstance(state, LearnedState)
        least = ROLLOUTS_TO_VOUCH if can_anneal(state.plan) else rollouts_to_vouch(state.samples)
        return max(share, min(state.rollouts - rows, least))


def mixture_of(sample: Sample) -> TapeMixture | None:
    """Return the proposal of a final sample, None for the target."""
    assert isinstance(sample.source, TapeSource)
    return sample.source.mixture
