"""Cross-entropy method: stages that learn a proposal from their elite, then a fresh sample.

The learnt law only decides from where to draw; the estimate comes from a sample that no stage has seen, with
true weights and rows of the target mixed in (stl-ams, section IV, "Imp-CE", with its errors corrected).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from avrare.base.memory import allowance
from avrare.estimation.plan.cost_forecast import CostForecast
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import Info, Plan
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare_estimators.ce.config import CeConfig, GaussianFamilyConfig, NetworkFamilyConfig
from avrare_estimators.ce.gaussian_family import GaussianFamily
from avrare_estimators.common.cost import affordable_rollouts
from avrare_estimators.common.samples.sampling import PartialSample, Sample, wave_rows
from avrare_estimators.common.samples.sources import Source
from avrare_estimators.common.samples.weighted_sampler import SamplingState, WeightedSampler
from avrare_estimators.common.weights import annealed, effective_size

_TAPES = 4
"""Tapes of each row to learn from at the peak."""
_LEAST_SHARE = 0.5
"""Effective size of the elite's weights, as a share of its rows: below it they are annealed."""


class Family(Protocol):
    """A set of laws to learn a proposal from."""

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem that can be drawn from the family's laws."""

    def start(self) -> Source:
        """Return the target itself."""

    def with_details(self, source: Source) -> Source:
        """Return the same law, its rollouts reported in the detail that ``fit`` needs."""

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """Return the law that fits ``rows`` of a sample best; their weights add up to 1."""


def build(config: CeConfig, scene: object | None = None) -> CrossEntropy:
    """Build the estimator of a scenario or a call.

    Raises:
        PluginError: A network is asked for and torch is not installed.
    """
    return CrossEntropy(config)


class CrossEntropy(WeightedSampler):
    """Estimator ``ce``: learns a proposal, then samples from it."""

    name = "ce"
    config: CeConfig

    def __init__(self, config: CeConfig) -> None:
        self.config = config
        self.family = _build_family(config)

    def prepare(self, problem: Problem) -> Problem:
        """Return the problem that the family can draw from."""
        prepared = self.family.prepare(problem)
        if prepared is not problem:
            self.noise_size = problem.noise_size
        return prepared

    def init(self, plan: Plan) -> tuple[SamplingState, Info]:
        """Return the state before the first rollout, and what to show."""
        state = SamplingState(plan, self._rollouts(plan), self.family.start())
        most = self.config.runs * state.rollouts * (self.config.stages + 1)
        least = 2 * self.config.runs * state.rollouts if plan.budget is None else most
        forecast = CostForecast("rollouts", least, most / (1.0 - self.config.check))
        return self._begin_run(replace(state, tally=Info(forecast=forecast))), Info(forecast=forecast)

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the samples and of the rows that a stage learns from."""
        demand, rollouts = super().demand(plan, carry), self._rollouts(plan)
        learnt = (
            min(math.ceil(self.config.elite * rollouts), self._most_learnt(plan)) * _TAPES * plan.tape_bytes
        )
        if isinstance(self.config.family, NetworkFamilyConfig):
            learnt = rollouts * (plan.steps + 1) * carry
            if self.config.memory is not None:
                learnt = min(learnt, allowance(self.config.memory) // 2)
        return replace(demand, bytes=demand.bytes + learnt)

    def _rollouts(self, plan: Plan) -> int:
        config = self.config
        return affordable_rollouts(plan, config.rollouts, config.runs, config.stages + 1, config.check)

    def _rows(self, plan: Plan) -> int:
        return self._rollouts(plan) * (self.config.stages + 1)

    def _most_learnt(self, plan: Plan) -> int:
        return max(2, allowance(self.config.memory) // (2 * _TAPES * plan.tape_bytes))

    def _begin_run(self, state: SamplingState) -> SamplingState:
        return self._learn(replace(state, source=self.family.start()))

    def _sample_rows(self, state: SamplingState) -> int:
        # What a budget holds for stages that learning did not need is for the sample that counts.
        unused = self.config.stages - len(state.stages) if state.plan.budget is not None else 0
        return state.rollouts * (1 + unused)

    def _learn(self, state: SamplingState) -> SamplingState:
        # 1. Draw a sample to learn from; the first is plain Monte Carlo.
        stage = len(state.stages)
        target_rows = state.rollouts if stage == 0 else round(self.config.target_share * state.rollouts)
        source = self.family.with_details(state.source)
        wave = wave_rows(state.plan, self.config.memory)
        task = PartialSample.begin(source, state.plan, state.run, stage, state.rollouts, target_rows, wave)
        return replace(state, task=task)

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        if self._learnt(state):
            return super()._sample_complete(state, sample)
        # 2. Fit the family to the elite, with annealed weights.
        rows, entry = elite(sample, self.config.elite)
        rows = rows[:: max(1, -(-len(rows) // self._most_learnt(state.plan)))]
        logs = sample.log_weights[rows]
        entry["elite_effective"] = effective_size(np.exp(logs))
        if len(rows):
            weights = annealed(logs, _LEAST_SHARE * len(rows))
            state = replace(state, source=self.family.fit(sample, rows, weights))
        # 3. Learning ends once the elite has reached failure twice, or once with even weights.
        before = bool(state.stages) and state.stages[-1]["reached"]
        even = entry["elite_effective"] >= _LEAST_SHARE * len(rows)
        entry["settled"] = entry["reached"] and (before or even)
        state = replace(state, stages=(*state.stages, entry))
        # 4. The estimate rests on a sample that no stage has seen.
        return super()._begin_run(state) if self._learnt(state) else self._learn(state)

    def _learnt(self, state: SamplingState) -> bool:
        stages = state.stages
        return bool(stages) and (stages[-1]["settled"] or len(stages) == self.config.stages)


def elite(sample: Sample, share: float) -> tuple[Integers, dict[str, Any]]:
    """Return the rows nearest to failure, and the report of the stage.

    Rows are ordered by (score, violated). If enough of them fail, the elite are the failing ones: the level
    has reached failure.
    """
    alive = np.flatnonzero(~sample.error & np.isfinite(sample.log_weights))
    size = min(max(2, round(share * len(sample.error))), len(alive))
    reached = int(sample.violated[alive].sum()) >= size > 0
    order = alive[np.lexsort((sample.violated[alive], sample.score[alive]))]
    rows = alive[sample.violated[alive]] if reached else np.sort(order[len(order) - size :])
    weights = np.exp(sample.log_weights)
    entry = {
        "level": float(sample.score[order[len(order) - size]]) if size else None,
        "reached": reached,
        "failures": int(sample.violated.sum()),
        "probability": float(np.where(sample.violated, weights, 0.0).mean()),
        "mean_weight": float(weights.mean()),
        "effective_size": effective_size(weights),
    }
    return rows, entry


def _build_family(config: CeConfig) -> Family:
    if isinstance(config.family, GaussianFamilyConfig):
        return GaussianFamily(config.family, config.elite)
    from avrare_estimators.ce.network_family import NetworkFamily

    return NetworkFamily(config, config.family)
