"""Importance sampling whose proposal on the noise tape is learnt: pilot, stages, then a fresh sample.

Every number of a proposal is fixed before the first of its rows is drawn. So is the share of the estimate
that these rows have: a stage whose forerunner has shown a gain over Monte Carlo counts, the pilot never does.
Each sample is unbiased given those before it, and so is their sum, whatever was learnt in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from avrare.estimation.plan.cost_forecast import CostForecast
from avrare.estimation.plan.plan import GaveUp, Info, Plan
from avrare.estimation.result.note import Note, describe_missed_goal, describe_precision
from avrare.estimation.result.result import Result
from avrare.rollout.problem import Problem
from avrare_estimators.common.cost import affordable_rollouts
from avrare_estimators.common.lessons.coverage import find_coverage_doubts
from avrare_estimators.common.lessons.lessons import Lessons
from avrare_estimators.common.lessons.stored_proposal import FILE, described
from avrare_estimators.common.lessons.words import NoiseNames, describe_failures
from avrare_estimators.common.looks import Looks
from avrare_estimators.common.samples.cross_check import CrossCheck, rollouts_to_vouch
from avrare_estimators.common.samples.sampling import (
    PartialSample,
    Sample,
    failing_weights,
    variance_of_sum,
    wave_rows,
)
from avrare_estimators.common.samples.scale_annealing import (
    MOST_NUMBERS,
    ROLLOUTS_TO_VOUCH,
    ScaleAnnealing,
)
from avrare_estimators.common.samples.sources import TapeSource
from avrare_estimators.common.samples.stages import (
    LEAST_GAIN,
    gain_nothing,
    has_reached,
    is_learnt,
    is_stuck,
    is_worthless,
)
from avrare_estimators.common.samples.weighted_sampler import SamplingState, WeightedSampler
from avrare_estimators.common.tapes.tail_atoms import tail_atoms, with_tail_atoms
from avrare_estimators.common.tapes.tape_mixture import TapeMixture, blend
from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.proposal_file import ProposalFile

_PILOT_SHARE, _LEARNING_SHARE, _LEARNING_SHARE_OF_GOAL = 6, 2, 3
"""The pilot takes at most 1 / 6 of the rollouts of a run, all learning at most half; where an error is asked
for, a third."""
_TARGET_OF_PILOT = 0.5
"""Share of the pilot that is drawn from the target."""
_LEAST_LOOK = 1000
_MOST_COUNTED = 0.5
"""Largest share of the estimate that the stages of learning have together: their variance may then be twice
what was expected, and a relative error asked for is still within reach."""
_NEAR_FLOOR = 1.25
"""Ratio of the variance to that of the stages that count below which further rows are not worth drawing."""
_LAST_STAGES = 2.0
"""Stages in whose cost the estimate can be ended: then learning more does not pay."""
_WORTHLESS = "learning found no proposal that beats Monte Carlo by a factor of two"

_AT_FLOOR = (
    "The run ended before it reached its goal: the stages of learning that count leave an error of {:.0%} "
    "that more rollouts do not lower; `--learned` with the learned.json of this run draws them all anew."
)
_UNREACHED = "learning did not reach a failure"


@dataclass(frozen=True)
class LearnedState(SamplingState):
    """State of runs that learn.

    Attributes:
        lessons: Stages of the present run.
        looks: Numbers of rows at which the final sample may end; None while learning.
        final: Parts of the final sample so far.
        shares: Share of the estimate that each stage has, the present one included.
    """

    lessons: Lessons = field(default_factory=lambda: Lessons(0.0))
    looks: Looks | None = None
    final: tuple[Sample, ...] = ()
    shares: tuple[float, ...] = ()

    @property
    def left(self) -> float:
        """Share of the estimate that no stage has."""
        return 1.0 - sum(self.shares)

    @property
    def rows(self) -> int:
        """Rollouts of this run, but for a cross-check."""
        return sum(len(sample.error) for sample in self.samples)


class LearnedSampling(WeightedSampler):
    """Estimator ``is`` with ``proposal: learned``."""

    name = "is"
    config: IsConfig
    names: NoiseNames | None = None

    def __init__(self, config: IsConfig, file: ProposalFile | None = None) -> None:
        self.config = config
        self.file = file

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
        return affordable_rollouts(plan, self.config.most_rollouts, self.config.runs, stages=1)

    def estimate(self, state: LearnedState) -> list[Result]:  # type: ignore[override]
        """Return the estimate from the final samples, what was learnt, and the file of the proposal."""
        assert self.names is not None
        result = super().estimate(state)[0]
        samples = [run.sample for run in state.finished]
        causes = describe_failures(samples, self.names)
        told = {
            "learning_rollouts": sum(stage["rollouts"] for run in state.finished for stage in run.stages),
            "learnt": [cause.data for cause in causes],
        }
        notes = [cause.note for cause in causes]
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
            told["proposal"] = frozen.digest
            artifacts = {FILE: described(frozen, self.names)}
        interval_at = result.interval_at
        if self.config.relative_error is not None and state.looks is not None:
            rows = self._size_at_look(state)
            interval_at = state.looks.interval(rows, interval_at)
            told["goal_reached"] = bool(result.relative_error <= self.config.relative_error)
            if not told["goal_reached"] and rows < state.looks.runs[-1]:
                floor = math.sqrt(variance_of_sum(state.finished[0].counted, result.probability))
                notes.insert(0, Note("goal", _AT_FLOOR.format(floor)))
            elif not told["goal_reached"]:
                progress = describe_precision(result.probability, result.relative_error)
                notes.insert(0, describe_missed_goal(result.rollouts, progress))
        complete = replace(
            result,
            interval_at=interval_at,
            diagnostics=result.diagnostics | told,
            artifacts=artifacts,
            notes=(*result.notes, *notes),
        )
        return [complete]

    def _size_at_look(self, state: LearnedState) -> int:
        """Return the size, as looks count it, at which the only run has ended."""
        return len(state.finished[0].sample.error)

    def _begin_run(self, state: SamplingState) -> LearnedState:
        assert isinstance(state, LearnedState)
        plan = state.plan
        lessons = Lessons(self.config.target_share, beside=tail_atoms(plan.steps, plan.noise.noise_size))
        state = replace(state, lessons=lessons, looks=None, final=(), shares=())
        if self.file is not None:
            return self._begin_final(state, with_tail_atoms(self.file.find(state.plan)))
        return self._learn(state)

    def _learn(self, state: LearnedState) -> LearnedState:
        # 1. A pilot from the target and from tail atoms, then stages from what the stages before have taught.
        stage, source = len(state.stages), TapeSource(state.lessons.proposal)
        rows = self._stage_rows(state, stage)
        target_rows = round((self.config.target_share if stage else _TARGET_OF_PILOT) * rows)
        wave = wave_rows(state.plan, self.config.memory)
        task = PartialSample.begin(source, state.plan, state.run, stage, rows, target_rows, wave)
        shares = (*state.shares, self._share(state, rows))
        return replace(state, source=source, task=task, shares=shares)

    def _share(self, state: LearnedState, rows: int) -> float:
        """Return the share of the estimate that the next stage has: that of its rows in all that it takes."""
        shown = state.lessons.shown_variance if state.stages else None
        if shown is None or state.stages[-1]["gain_shown"] < LEAST_GAIN:
            return 0.0
        share = state.left * rows / max(rows, self._missing(state, shown))
        return min(share, max(0.0, _MOST_COUNTED - sum(state.shares)))  # the sum is rounded

    def _missing(self, state: LearnedState, variance: float) -> float:
        """Return the rows of this variance that the rest of the estimate takes."""
        most = float(self._affordable(state))
        if self.config.relative_error is None:
            return most
        counted = counted_samples(state)
        floor = variance_of_sum(counted, state.lessons.probability) if counted else 0.0
        rest = max(self.config.relative_error**2, _NEAR_FLOOR * floor) - floor
        return min(most, state.left**2 * variance / rest)

    def _affordable(self, state: LearnedState) -> int:
        return max(2, int((1.0 - self.config.check) * state.rollouts) - state.rows)

    def _stage_rows(self, state: LearnedState, stage: int) -> int:
        pilot = max(2, min(self.config.pilot, state.rollouts // _PILOT_SHARE))
        return pilot if stage == 0 else max(1, pilot // 2)

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        assert isinstance(state, LearnedState)
        if state.looks is not None:
            return self._look(replace(state, final=(*state.final, sample)))
        lessons = state.lessons.add(sample)
        return self._after_stage(replace(state, lessons=lessons, stages=(*state.stages, lessons.report())))

    def _after_stage(self, state: LearnedState) -> LearnedState:
        if self._learnt(state):
            # 2. What the stages have seen decides from where to draw, once and for all. Where some of them
            #    count, it is from the proposal: to leave them out for what they have seen would be a bias.
            last, counts = state.stages[-1], any(state.shares)
            plain = is_worthless(last) and not counts
            if (plain or not (counts or has_reached(last))) and not self.config.fall_back:
                reason = _WORTHLESS if plain and not is_stuck(state.stages) else _UNREACHED
                raise GaveUp.after(state.tally, reason, "leave fall_back true, or use another estimator")
            return self._begin_final(state, None if plain else state.lessons.final())
        return self._learn(replace(state, lessons=state.lessons.learn()))

    def _learnt(self, state: LearnedState) -> bool:
        done = sum(stage["rollouts"] for stage in state.stages)
        share = _LEARNING_SHARE if self.config.relative_error is None else _LEARNING_SHARE_OF_GOAL
        affordable = done + self._stage_rows(state, 1) <= state.rollouts // share
        hopeless = not len(state.lessons.elite[0])
        hopeless |= not self.config.fall_back and is_stuck(state.stages)
        ended = is_learnt(state.stages, self.config.stages) or self._gives_up(state)
        return hopeless or not affordable or self._ends(state) or ended

    def _gives_up(self, state: LearnedState) -> bool:
        """Return whether stages gain nothing over Monte Carlo."""
        return gain_nothing(state.stages)

    def _ends(self, state: LearnedState) -> bool:
        """Return whether the estimate is nearly done: another stage would cost more than it saves."""
        shown = state.lessons.shown_variance
        if self.config.relative_error is None or shown is None or not state.lessons.mixtures:
            return False
        if not has_reached(state.stages[-1]):
            return False
        return self._missing(state, shown) < _LAST_STAGES * self._stage_rows(state, 1)

    def _begin_final(self, state: LearnedState, mixture: TapeMixture | None) -> LearnedState:
        source, goal = TapeSource(mixture), self.config.relative_error
        most, first = self._affordable(state), self._affordable(state)
        if goal is not None:
            variance = state.lessons.expected_variance(mixture) or 0.0
            if state.stages:
                variance = max(variance, state.lessons.shown_variance or 0.0)
            first = min(most, max(_LEAST_LOOK, int(self._missing(state, variance) / 2.0)))
        looks = Looks.until(goal, first, most)
        return self._draw(replace(state, source=source, looks=looks), looks.runs[0])

    def _look(self, state: LearnedState) -> SamplingState:
        # 3. The final sample ends at the first look at which the estimate is exact enough, or about as exact
        #    as its stages let it become.
        assert state.looks is not None
        sample, counted = Sample.join(state.final), counted_samples(state)
        parts = [(state.left, sample), *counted]
        more = state.looks.missing(len(sample.error), lambda: relative_error(parts))
        if more and not is_at_floor(parts, counted):
            return self._draw(state, more)
        learning = state.samples[: len(state.samples) - len(state.final)]
        return self._check(replace(state, samples=(*learning, sample)), sample)

    def _draw(self, state: LearnedState, rows: int) -> LearnedState:
        assert isinstance(state.source, TapeSource)
        plain = state.source.mixture is None
        target_rows = rows if plain else round(self.config.target_share * rows)
        stage = len(state.stages) + len(state.final)
        wave = wave_rows(state.plan, self.config.memory)
        task = PartialSample.begin(state.source, state.plan, state.run, stage, rows, target_rows, wave)
        return replace(state, task=task)

    def _counted(self, state: SamplingState) -> tuple[tuple[float, Sample], ...]:
        assert isinstance(state, LearnedState)
        return counted_samples(state)

    def _cross_check(self, state: SamplingState, most: int) -> CrossCheck | ScaleAnnealing | None:
        """Return the check by annealing, which no score leads; by a climb where tapes are long."""
        annealing = ScaleAnnealing.begin(state.samples, self._check_rollouts(state))
        return annealing or super()._cross_check(state, most)

    def _check_rollouts(self, state: SamplingState) -> int:
        """Return the cross-check's rollouts; where an error is asked for, at least what an answer takes.

        There the sample is as small as the error allows, and a share of it too small to climb with.
        """
        share = super()._check_rollouts(state)
        if self.config.relative_error is None or not self.config.check:
            return share
        assert isinstance(state, LearnedState)
        plan, least = state.plan, self._rollouts_to_vouch(state)
        if (plan.steps + 1) * plan.noise.noise_size <= MOST_NUMBERS:
            least = ROLLOUTS_TO_VOUCH
        return max(share, min(state.rollouts - state.rows, least))

    def _rollouts_to_vouch(self, state: LearnedState) -> int:
        return rollouts_to_vouch(state.samples)

    def _doubts(self, state: SamplingState) -> dict[str, str]:
        assert isinstance(state, LearnedState)
        return find_coverage_doubts(state.lessons, state.samples[-1])


def counted_samples(state: LearnedState) -> tuple[tuple[float, Sample], ...]:
    """Return the stages that count, and their shares of the estimate."""
    samples = state.samples[: len(state.shares)]
    return tuple((share, sample) for share, sample in zip(state.shares, samples, strict=True) if share)


def relative_error(parts: Sequence[tuple[float, Sample]]) -> float:
    """Return the standard error of an estimate over the estimate; infinite without a failure.

    Args:
        parts: Samples that count, and their shares of the estimate.
    """
    mean = sum(share * float(failing_weights(sample).mean()) for share, sample in parts)
    return math.sqrt(variance_of_sum(parts, mean)) if mean else math.inf


def is_at_floor(parts: Sequence[tuple[float, Sample]], counted: Sequence[tuple[float, Sample]]) -> bool:
    """Return whether most of the variance of an estimate is that of its stages, ``counted``."""
    return variance_of_sum(parts, 1.0) < _NEAR_FLOOR * variance_of_sum(counted, 1.0)


def mixture_of(sample: Sample) -> TapeMixture | None:
    """Return the proposal of a final sample; None where it was drawn from the target."""
    assert isinstance(sample.source, TapeSource)
    return sample.source.mixture
