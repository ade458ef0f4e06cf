"""Importance sampling: draw from a proposal under which failures are frequent, count them by weight."""

from __future__ import annotations

from typing import Any

from avrare.estimation.plan.plan import Info, Plan
from avrare.rollout.problem import Problem
from avrare.rollout.weighted_problem import WeightedProblem
from avrare_estimators.common.cost import affordable_rollouts
from avrare_estimators.common.samples.sources import LatentSource, PerceptionSource, Source
from avrare_estimators.common.samples.weighted_sampler import SamplingState, WeightedSampler
from avrare_estimators.common.tapes.gaussian_mixture import GaussianMixture
from avrare_estimators.importance.config import GaussianProposal, IsConfig, is_perception


class ImportanceSampling(WeightedSampler):
    """Estimator ``is``: samples from a given proposal."""

    name = "is"
    config: IsConfig

    def __init__(self, config: IsConfig) -> None:
        self.config = config

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem; for a perception model, the closed loop drawn from it, with weights.

        Raises:
            UsageError: The problem has no perception whose density is known.
        """
        if not is_perception(self.config.proposal):
            return problem
        self.noise_size = problem.noise_size
        return WeightedProblem(problem, self.config.proposal)

    def init(self, plan: Plan) -> tuple[SamplingState, Info]:
        """Return the state before the first rollout, and its progress."""
        rollouts = self._rows(plan)
        info = Info(goal=rollouts * self.config.runs)
        return self._begin_run(SamplingState(plan, rollouts, self._source(plan), tally=info)), info

    def _rows(self, plan: Plan) -> int:
        return affordable_rollouts(plan, self.config.most_rollouts, self.config.runs, stages=1)

    def _sample_rows(self, state: SamplingState) -> int:
        return state.rollouts - int(self.config.check * state.rollouts)

    def _source(self, plan: Plan) -> Source:
        proposal: Any = self.config.proposal
        if is_perception(proposal):
            return PerceptionSource()
        if isinstance(proposal, GaussianProposal):
            shape = (plan.steps + 1, plan.noise.noise_size)
            proposal = GaussianMixture.single(proposal.mean, proposal.std, shape)
        return LatentSource(proposal)
