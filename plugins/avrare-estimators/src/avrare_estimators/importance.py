"""Importance sampling: draw from a proposal under which failures are frequent, count them by weight."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from avrare.build.weighted import WeightedProblem
from avrare.errors import UsageError
from avrare.estimation.plan import Info, Plan
from avrare.estimation.result import Result
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare_estimators.config import CeConfig, IsConfig
from avrare_estimators.estimates import RunOutcome, summarise
from avrare_estimators.proposals import Gaussian, kind_of
from avrare_estimators.sampling import Drawing, Sample
from avrare_estimators.second_look import FEWEST, SecondLook, Seen
from avrare_estimators.sources import LatentSource, PerceptionSource, Source
from avrare_estimators.splitting import Tally


def build(config: IsConfig, scene: object | None = None) -> ImportanceSampling:
    """The estimator of a scenario or a call."""
    return ImportanceSampling(config)


@dataclass(frozen=True)
class SamplingState:
    """State of runs that follow one another.

    Attributes:
        plan: The task.
        rollouts: Of a run's final sample, its second look included.
        source: The proposal in use.
        task: What is being asked for; None when all is done.
        sample: Final sample of the present run, once drawn.
        stages: What the present run has learnt from, one entry a stage.
        finished: Runs done.
        tally: Costs so far.
        first: Robustness of the first sample, NaN for errors.
    """

    plan: Plan
    rollouts: int
    source: Source
    task: Drawing | SecondLook | None = None
    sample: Sample | None = None
    stages: tuple[dict[str, Any], ...] = ()
    finished: tuple[RunOutcome, ...] = ()
    tally: Tally = field(default_factory=Tally)
    first: Floats | None = None

    @property
    def run(self) -> int:
        """Index of the present run."""
        return len(self.finished)


class Sampler:
    """What importance sampling and cross-entropy share: a final sample, a second look, the next run."""

    name: str
    single = True
    needs = ("noise",)
    config: IsConfig | CeConfig
    noise_size: int | None = None
    """Of the problem that the user gave, where it was replaced."""

    def ask(self, state: SamplingState) -> Request | None:
        """The next wave."""
        return state.task.pending if state.task is not None else None

    def tell(self, state: SamplingState, rollouts: Rollouts) -> tuple[SamplingState, Info]:
        """Store the wave; when a sample or a look is complete, decide what comes next."""
        assert state.task is not None
        task = state.task.tell(rollouts)
        state = replace(state, tally=state.tally.plus(rollouts), task=task)
        if task.pending is None:
            state = (
                self._look_ended(state, task) if isinstance(task, SecondLook) else self._drawn(state, task)
            )
        return state, self._info(state)

    def estimate(self, state: SamplingState) -> list[Result]:
        """The weighted mean, its interval, and what the weights say of both."""
        return [summarise(self.name, state.plan, state.finished, state.tally, state.first, self.noise_size)]

    def _drawn(self, state: SamplingState, drawing: Drawing) -> SamplingState:
        sample = drawing.sample()
        if state.first is None:
            state = replace(state, first=np.where(sample.error, np.nan, sample.robustness))
        return self._sampled(state, sample)

    def _sampled(self, state: SamplingState, sample: Sample) -> SamplingState:
        """A sample is complete: look at it once more."""
        look = SecondLook.begin(sample, self._looks(state.rollouts))
        state = replace(state, sample=sample.slim(), task=look)
        return state if look is not None else self._finish(state, None)

    def _look_ended(self, state: SamplingState, look: SecondLook) -> SamplingState:
        return self._finish(state, look.seen())

    def _finish(self, state: SamplingState, seen: Seen | None) -> SamplingState:
        assert state.sample is not None
        outcome = RunOutcome(state.sample, self.config.check > 0.0, seen, state.stages)
        state = replace(state, finished=(*state.finished, outcome), sample=None, stages=(), task=None)
        return state if state.run == self.config.runs else self._begin(state)

    def _begin(self, state: SamplingState) -> SamplingState:
        """The first sample of the next run."""
        return self._final(state)

    def _final(self, state: SamplingState) -> SamplingState:
        """Draw the sample that the estimate rests on."""
        rows = state.rollouts - self._looks(state.rollouts)
        target_rows = round(self.config.defensive * rows)
        stage = len(state.stages)
        task = Drawing.begin(state.source, state.plan, state.run, stage, rows, target_rows)
        return replace(state, task=task)

    def _looks(self, rollouts: int) -> int:
        """Rollouts of the second look."""
        looks = int(self.config.check * rollouts)
        return looks if looks >= FEWEST else 0

    def _info(self, state: SamplingState) -> Info:
        tally = state.tally
        estimates = [outcome.probability for outcome in state.finished]
        return Info(
            stage=len(state.stages),
            level=state.stages[-1]["level"] if state.stages else None,
            probability=float(np.mean(estimates)) if estimates else None,
            rollouts=tally.rollouts, failures=tally.failures, errors=tally.errors, counts=dict(tally.counts),
        )  # fmt: skip


class ImportanceSampling(Sampler):
    """Samples from a proposal that is given."""

    name = "is"
    config: IsConfig

    def __init__(self, config: IsConfig) -> None:
        self.config = config
        self.kind = kind_of(config.proposal)

    def prepare(self, problem: Problem) -> Problem:
        """With a perception model as proposal: the closed loop that is drawn from it and carries weights.

        Raises:
            UsageError: The problem has no perception whose density is known.
        """
        if self.kind not in ("plugin", "perception"):
            return problem
        self.noise_size = problem.noise_size
        return WeightedProblem(problem, self.config.proposal)

    def init(self, plan: Plan) -> tuple[SamplingState, Info]:
        """State before the first rollout, and what to show."""
        rollouts = affordable(plan, self.config.rollouts, self.config.runs, stages=1)
        state = SamplingState(plan, rollouts, self._source(plan))
        return self._begin(state), Info(goal=rollouts * self.config.runs)

    def _source(self, plan: Plan) -> Source:
        proposal: Any = self.config.proposal
        if self.kind in ("plugin", "perception"):
            return PerceptionSource()
        if self.kind == "gaussian":
            numbers = proposal["gaussian"]
            shape = (plan.steps + 1, plan.noise.noise_size)
            proposal = Gaussian.of(numbers.get("mean", 0.0), numbers.get("std", 1.0), shape)
        return LatentSource(proposal)


def affordable(plan: Plan, rollouts: int, runs: int, stages: int) -> int:
    """Rollouts of a stage that the budget pays for, if all runs need all stages; without one: ``rollouts``.

    Raises:
        UsageError: It pays for too few, or is one of seconds.
    """
    budget = plan.budget
    if budget is None:
        return rollouts
    if budget.kind == "seconds":
        raise UsageError(
            "weighted samples cannot be stopped by the clock: a stage that has started must finish",
            "give the budget as steps=N or rollouts=N",
        )
    cost = (max(plan.steps, 1) if budget.kind == "steps" else 1) * runs * stages
    paid = int(budget.amount // cost)
    least = 2 if stages == 1 else 20
    if paid < least:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for {runs} run(s) of {stages} "
            f"stage(s) of {least} rollouts",
            f"raise it to {least * cost}",
        )
    return paid
