"""The cross-entropy method: stages that learn a proposal from their elite, then a fresh sample.

What is learnt only decides from where to draw; the estimate comes from a sample that no stage has seen, with
true weights and rows of the target mixed in (stl-ams, section IV, "Imp-CE", without what was wrong with it).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from avrare.estimation.plan import Info, Plan
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare_estimators.config import CeConfig
from avrare_estimators.gaussian import GaussianFamily
from avrare_estimators.importance import Sampler, SamplingState, affordable
from avrare_estimators.sampling import Drawing, Sample
from avrare_estimators.sources import Source
from avrare_estimators.weights import annealed, effective_size

_LEAST_SHARE = 0.5
"""Effective size of the elite's weights, as a share of its rows: below it they are annealed."""


class Family(Protocol):
    """A set of laws that a proposal is learnt from."""

    def prepare(self, problem: Problem) -> Problem:
        """The problem that can be drawn from the family's laws."""

    def start(self) -> Source:
        """The target itself."""

    def watched(self, source: Source) -> Source:
        """The same law, its rollouts reported in the detail that ``fit`` needs."""

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """The law that fits ``rows`` of a sample best, each with its weight; weights add up to 1."""


def build(config: CeConfig, scene: object | None = None) -> CrossEntropy:
    """The estimator of a scenario or a call.

    Raises:
        PluginError: A network is asked for and torch is not installed.
    """
    return CrossEntropy(config)


class CrossEntropy(Sampler):
    """Learns a proposal, then samples from it."""

    name = "ce"
    config: CeConfig

    def __init__(self, config: CeConfig) -> None:
        self.config = config
        self.family = _family(config)

    def prepare(self, problem: Problem) -> Problem:
        """The problem that the family can draw from."""
        prepared = self.family.prepare(problem)
        if prepared is not problem:
            self.noise_size = problem.noise_size
        return prepared

    def init(self, plan: Plan) -> tuple[SamplingState, Info]:
        """State before the first rollout, and what to show."""
        rollouts = affordable(plan, self.config.rollouts, self.config.runs, self.config.stages + 1)
        return self._begin(SamplingState(plan, rollouts, self.family.start())), Info()

    def _begin(self, state: SamplingState) -> SamplingState:
        return self._learn(replace(state, source=self.family.start()))

    def _learn(self, state: SamplingState) -> SamplingState:
        """Draw one more sample to learn from; the first is plain Monte Carlo."""
        stage = len(state.stages)
        target_rows = state.rollouts if stage == 0 else round(self.config.defensive * state.rollouts)
        source = self.family.watched(state.source)
        task = Drawing.begin(source, state.plan, state.run, stage, state.rollouts, target_rows)
        return replace(state, task=task)

    def _sampled(self, state: SamplingState, sample: Sample) -> SamplingState:
        if self._learnt(state):
            return super()._sampled(state, sample)
        rows, entry = elite(sample, self.config.elite)
        logs = sample.log_weights[rows]
        entry["elite_effective"] = effective_size(np.exp(logs))
        if len(rows):
            weights = annealed(logs, _LEAST_SHARE * len(rows))
            state = replace(state, source=self.family.fit(sample, rows, weights))
        before = bool(state.stages) and state.stages[-1]["reached"]
        entry["settled"] = entry["reached"] and (
            before or entry["elite_effective"] >= _LEAST_SHARE * len(rows)
        )
        state = replace(state, stages=(*state.stages, entry))
        return self._final(state) if self._learnt(state) else self._learn(state)

    def _learnt(self, state: SamplingState) -> bool:
        stages = state.stages
        return bool(stages) and (stages[-1]["settled"] or len(stages) == self.config.stages)


def elite(sample: Sample, share: float) -> tuple[Integers, dict[str, Any]]:
    """The rows nearest to failure, and what a stage has to report.

    Rows are ordered by (score, violated). If enough of them fail, the elite are the failing ones: the level
    has reached failure.
    """
    alive = np.flatnonzero(~sample.error & np.isfinite(sample.log_weights))
    many = min(max(2, round(share * len(sample.error))), len(alive))
    reached = int(sample.violated[alive].sum()) >= many > 0
    order = alive[np.lexsort((sample.violated[alive], sample.score[alive]))]
    rows = alive[sample.violated[alive]] if reached else np.sort(order[len(order) - many :])
    weights = np.exp(sample.log_weights)
    entry = {
        "level": float(sample.score[order[len(order) - many]]) if many else None,
        "reached": reached,
        "failures": int(sample.violated.sum()),
        "probability": float(np.where(sample.violated, weights, 0.0).mean()),
        "mean_weight": float(weights.mean()),
        "effective_size": effective_size(weights),
    }
    return rows, entry


def _family(config: CeConfig) -> Family:
    if config.family == "gaussian":
        return GaussianFamily(config)
    from avrare_estimators.learned import NetworkFamily

    return NetworkFamily(config)
