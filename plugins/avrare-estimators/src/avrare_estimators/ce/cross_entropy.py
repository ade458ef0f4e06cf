"""Cross-entropy method: stages that learn a proposal from their elite, then a fresh sample.

The proposal tilts the target's perception by a network, which learns in torch and runs in NumPy. It only
decides from where to draw; the estimate comes from a sample that no stage has seen, with true weights and
rows of the target mixed in (stl-ams, section IV, "Imp-CE", with its errors corrected).
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base.errors import PluginError
from avrare.base.memory import allowance
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import CostForecast, Info, Plan
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.rollout.weighted_problem import WeightedProblem
from avrare_estimators.ce.config import CeConfig
from avrare_estimators.ce.tilted_perception import Tilt, TrainingBatch, network_inputs, residuals
from avrare_estimators.common.cost import affordable_rollouts
from avrare_estimators.common.samples.sampling import PartialSample, Sample
from avrare_estimators.common.samples.sources import PerceptionSource
from avrare_estimators.common.samples.weighted_sampler import SamplingState, WeightedSampler
from avrare_estimators.common.weights import anneal, effective_size

_LEAST_SHARE = 0.5
"""Effective size of the elite's weights, as a share of its rows: below it they are annealed."""


def build(config: CeConfig, scene: object | None = None) -> CrossEntropy:
    """Build the estimator of a scenario or a call.

    Raises:
        PluginError: torch, in which the network learns, is not installed.
    """
    if importlib.util.find_spec("torch") is None:
        raise PluginError("estimator 'ce' needs torch", "pip install 'avrare-estimators[torch]'")
    return CrossEntropy(config)


class CrossEntropy(WeightedSampler):
    """Estimator ``ce``: learns a proposal, then samples from it."""

    name = "ce"
    config: CeConfig

    def __init__(self, config: CeConfig) -> None:
        self.config = config
        self.target: Any = None

    def prepare(self, problem: Problem) -> Problem:
        """Return the closed loop that can be drawn from tilted perception."""
        prepared = WeightedProblem(problem, needs="law")
        self.noise_size = problem.noise_size
        self.target = prepared.system.target.perception  # type: ignore[attr-defined]
        return prepared

    def init(self, plan: Plan) -> tuple[SamplingState, Info]:
        """Return the state before the first rollout, and its progress."""
        state = SamplingState(plan, self._rollouts(plan), PerceptionSource())
        most = self.config.runs * state.rollouts * (self.config.stages + 1)
        least = 2 * self.config.runs * state.rollouts if plan.budget is None else most
        forecast = CostForecast("rollouts", least, most / (1.0 - self.config.check))
        return self._begin_run(replace(state, tally=Info(forecast=forecast))), Info(forecast=forecast)

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the samples and of the carries that a stage learns from."""
        demand = super().demand(plan, carry)
        carries = self._rollouts(plan) * (plan.steps + 1) * carry
        if self.config.memory is not None:
            carries = min(carries, allowance(self.config.memory) // 2)
        return replace(demand, bytes=demand.bytes + carries)

    def _rollouts(self, plan: Plan) -> int:
        config = self.config
        return affordable_rollouts(plan, config.rollouts, config.runs, config.stages + 1, config.check)

    def _rows(self, plan: Plan) -> int:
        return self._rollouts(plan) * (self.config.stages + 1)

    def _begin_run(self, state: SamplingState) -> SamplingState:
        return self._learn(replace(state, source=PerceptionSource()))

    def _sample_rows(self, state: SamplingState) -> int:
        # What a budget holds for stages that learning did not need is for the sample that counts.
        unused = self.config.stages - len(state.stages) if state.plan.budget is not None else 0
        return state.rollouts * (1 + unused)

    def _learn(self, state: SamplingState) -> SamplingState:
        # 1. Draw a sample to learn from; the first is plain Monte Carlo.
        stage = len(state.stages)
        # The carries of every step, which the network learns from, as far as memory is given.
        memory, source = self.config.memory, state.source
        assert isinstance(source, PerceptionSource)
        most = 0 if memory is None else max(1, allowance(memory) // (2 * self.config.rollouts))
        source = replace(source, keep_carries=True, most_bytes=most)
        share = self.config.target_share if stage else 1.0
        task = PartialSample.begin(source, state.plan, state.run, stage, state.rollouts, share, memory)
        return replace(state, task=task)

    def _sample_complete(self, state: SamplingState, sample: Sample) -> SamplingState:
        if self._has_learnt(state):
            return super()._sample_complete(state, sample)
        # 2. Fit the network to the elite, with annealed weights.
        rows, entry = elite(sample, self.config.elite)
        logs = sample.log_weights[rows]
        entry["elite_effective"] = effective_size(np.exp(logs))
        if len(rows):
            weights = anneal(logs, _LEAST_SHARE * len(rows))
            state = replace(state, source=self._fit(sample, rows, weights))
        # 3. Learning ends once the elite has reached failure twice, or once with even weights.
        before = bool(state.stages) and state.stages[-1]["reached"]
        even = entry["elite_effective"] >= _LEAST_SHARE * len(rows)
        entry["settled"] = entry["reached"] and (before or even)
        state = replace(state, stages=(*state.stages, entry))
        # 4. The estimate rests on a sample that no stage has seen.
        return super()._begin_run(state) if self._has_learnt(state) else self._learn(state)

    def _fit(self, sample: Sample, rows: Integers, weights: Floats) -> PerceptionSource:
        """Fit the network to the rows' observations by maximum likelihood, starting from the present one."""
        from avrare_estimators.ce.training import train

        source, stratum = sample.source, sample.strata[0]
        assert isinstance(source, PerceptionSource)
        old = source.proposal.network if source.proposal is not None else None
        seeds = np.random.SeedSequence(stratum.plan.noise.seed, spawn_key=(stratum.run, stratum.stage))
        batch = _collect_observations(sample, rows, weights, self.target)
        # -log of the probability of the level that the sample has reached, each elite being a share.
        nats = -(stratum.stage + 1) * math.log(self.config.elite)
        return PerceptionSource(Tilt(train(batch, old, self.config, int(seeds.generate_state(1)[0]), nats)))

    def _has_learnt(self, state: SamplingState) -> bool:
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


def _collect_observations(sample: Sample, rows: Integers, weights: Floats, target: Any) -> TrainingBatch:
    """Return the observations along ``rows`` of a sample, each with the weight of its row."""
    weight = np.zeros(len(sample.error))
    weight[rows] = weights
    parts: list[tuple[Floats, ...]] = []
    dof = None
    for _, present, carry in sample.carries:
        state, row_weight = carry.system.loop, weight[present]
        if state.observation is None or not row_weight.any():
            continue
        law = target.law(state.world)
        dof = law.dof if hasattr(law, "dof") else None
        with np.errstate(divide="ignore"):
            log_odds = np.clip(np.log(law.detect) - np.log(law.miss), -50.0, 50.0)
        inputs = network_inputs(state.world, target.scene)
        each = np.broadcast_to(row_weight[:, None], inputs.shape[:2])
        chosen = each > 0.0
        errors = residuals(law, state.world, state.observation)
        columns = (inputs, state.observation.detected, log_odds, errors, each)
        parts.append(tuple(np.asarray(column[chosen], dtype=np.float64) for column in columns))
    inputs, detected, log_odds, errors, each = map(np.concatenate, zip(*parts, strict=True))
    return TrainingBatch(inputs, detected, log_odds, errors, each, dof)
