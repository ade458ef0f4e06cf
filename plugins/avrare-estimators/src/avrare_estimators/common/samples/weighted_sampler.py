"""Sampler of weighted rows: a final sample, its cross-check, the next run; ``is`` and ``ce`` extend it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from avrare.base.memory import allowance
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import Estimator, Info, Plan
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.request import Request, Rollouts
from avrare_estimators.common.config import WeightedConfig
from avrare_estimators.common.samples.checked_sample import CheckedSample
from avrare_estimators.common.samples.cross_check import CLIMB_TAPES, CrossCheck, CrossCheckResult
from avrare_estimators.common.samples.result import RunOutcome, summarise
from avrare_estimators.common.samples.sampling import PartialSample, Sample, wave_bytes
from avrare_estimators.common.samples.scale_annealing import ScaleAnnealing
from avrare_estimators.common.samples.sources import Source

_LEVELS = 2
"""Levels that the cross-check's chains climb at least where they are most."""


class Task(Protocol):
    """Sample or cross-check under way.

    Attributes:
        pending: The rollouts asked for; None at the end.
    """

    @property
    def pending(self) -> Request | None: ...  # noqa: D102

    def tell(self, rollouts: Rollouts) -> Task:
        """Continue with the rollouts asked for."""


@dataclass(frozen=True)
class SamplingState:
    """State of runs that follow one another.

    Attributes:
        plan: The task.
        rollouts: Rollouts of a sample, its cross-check included where the estimator counts it.
        source: The proposal in use.
        task: Work under way; None when all is done.
        samples: Samples of the present run so far; the last is the final one, once learning has ended.
        stages: Learning stages of the present run, one entry each.
        finished: Runs done.
        tally: Cost so far.
        first: Robustness of the first sample, NaN for errors.
        fresh: Counts of all rows drawn from the target.
    """

    plan: Plan
    rollouts: int
    source: Source
    task: Task | None = None
    samples: tuple[Sample, ...] = ()
    stages: tuple[dict[str, Any], ...] = ()
    finished: tuple[RunOutcome, ...] = ()
    tally: Info = field(default_factory=Info)
    first: Floats | None = None
    fresh: FreshRows = field(default_factory=FreshRows)

    @property
    def run(self) -> int:
        """Index of the present run."""
        return len(self.finished)


class WeightedSampler(Estimator):
    """Base class of importance sampling: each run draws a final sample and cross-checks it.

    Attributes:
        noise_size: Noise size of the user's problem, if this estimator replaced the problem.
    """

    name: str
    single = True
    final_scores = True
    needs = ("noise",)
    config: WeightedConfig
    noise_size: int | None = None

    def ask(self, state: SamplingState) -> Request | None:
        """Ask for the next wave."""
        return state.task.pending if state.task is not None else None

    def tell(self, state: SamplingState, rollouts: Rollouts) -> tuple[SamplingState, Info]:
        """Store the wave; when a sample or a cross-check is complete, begin the next task."""
        assert state.task is not None
        task = state.task.tell(rollouts)
        state = replace(state, tally=state.tally.plus(rollouts), task=task)
        if task.pending is None:
            state = self._task_complete(state)
        return state, self._info(state)

    def _task_complete(self, state: SamplingState) -> SamplingState:
        """Begin the task that follows."""
        task = state.task
        if isinstance(task, (CrossCheck, ScaleAnnealing)):
            return self._finish_run(state, task.result())
        if isinstance(task, CheckedSample):
            return self._finish_run(self._store(state, task.sample.sample()), task.check.result())
        assert isinstance(task, PartialSample)
        sample = task.sample()
        return self._sample_complete(self._store(state, sample), sample)

    def _store(self, state: SamplingState, sample: Sample) -> SamplingState:
        samples = (*state.samples, sample.without_carries())
        first = np.where(sample.error, np.nan, sample.robustness) if state.first is None else state.first
        return replace(state, samples=samples, fresh=state.fresh + sample.fresh, first=first)

    def estimate(self, state: SamplingState) -> list[Result]:
        """Return the weighted mean, its interval, and the health of the weights."""
        plan, fresh = state.plan, state.plan.seen + state.fresh
        return [summarise(self.name, plan, state.finished, state.tally, state.first, fresh, self.noise_size)]

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of all rows, of a wave and of the cross-check's chains beside it."""
        rows = self._rows(plan)
        tape, room = plan.tape_bytes, allowance(self.config.memory)
        share = self.config.check / (1.0 - self.config.check) / _LEVELS
        climb = min(int(share * rows) * CLIMB_TAPES * tape, room) if self.config.check else 0
        row_bytes = 150  # bytes of a row that is kept, at the peak
        held = row_bytes * rows * self.config.runs + wave_bytes(plan, self.config.memory) + climb
        return Demand(held, self.config.memory, "rollouts")

    def _rows(self, plan: Plan) -> int:
        """Return the rows of all samples of a run that are kept."""
        raise NotImplementedError

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        return self._check(state, sample)

    def _check(self, state: SamplingState, sample: Sample) -> SamplingState:
        """Begin the cross-check of the final sample, or end the run without."""
        plain = sample.share == 1.0  # Monte Carlo needs none
        check = None if plain else self._begin_check(state, 0)
        if check is None or check.pending is None:
            return self._finish_run(state, None if check is None else check.result())
        return replace(state, task=check)

    def _begin_check(self, state: SamplingState, rows: int) -> CrossCheck | ScaleAnnealing | None:
        """Return the check by annealing, which no score leads; by a climb where tapes are long.

        ``rows`` of the run are still to come; None where it would not end. Where its starts fail already, it
        has ended.
        """
        rollouts = self._check_rollouts(state, rows + sum(len(sample.error) for sample in state.samples))
        most = max(1, allowance(self.config.memory) // (CLIMB_TAPES * state.plan.tape_bytes))
        annealing = ScaleAnnealing.begin(state.samples, rollouts)
        check = annealing or CrossCheck.begin(state.samples, rollouts, most)
        begun = check is not None and (check.pending is not None or len(check.result().probabilities) > 0)
        return check if begun else None

    def _finish_run(self, state: SamplingState, result: CrossCheckResult | None) -> SamplingState:
        sample = state.samples[-1]
        checked = self.config.check > 0.0 and sample.share < 1.0
        outcome = RunOutcome(sample, checked, result, state.stages, self._list_counted_samples(state))
        state = replace(state, finished=(*state.finished, outcome), samples=(), stages=(), task=None)
        return state if state.run == self.config.runs else self._begin_run(state)

    def _begin_run(self, state: SamplingState) -> SamplingState:
        rows = self._sample_rows(state)
        stage, share, memory = len(state.stages), self.config.target_share, self.config.memory
        task = PartialSample.begin(state.source, state.plan, state.run, stage, rows, share, memory)
        return replace(state, task=task)

    def _sample_rows(self, state: SamplingState) -> int:
        """Return the rows of the final sample."""
        raise NotImplementedError

    def _list_counted_samples(self, state: SamplingState) -> tuple[tuple[float, Sample], ...]:
        """Return the samples of learning that count in the estimate, and their shares."""
        return ()

    def _check_rollouts(self, state: SamplingState, rows: int) -> int:
        """Return the rollouts for the cross-check of a run that has ``rows`` others."""
        return int(self.config.check / (1.0 - self.config.check) * rows)

    def _info(self, state: SamplingState) -> Info:
        estimates = [outcome.probability for outcome in state.finished]
        return replace(
            state.tally,
            stage=len(state.stages),
            level=state.stages[-1]["level"] if state.stages else None,
            probability=float(np.mean(estimates)) if estimates else None,
        )
