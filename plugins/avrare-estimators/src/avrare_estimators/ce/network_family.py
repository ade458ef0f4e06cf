"""Network family of cross-entropy ("Imp-CE" of stl-ams): learns in torch, runs in NumPy."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np

from avrare.base.errors import PluginError
from avrare.base.memory import allowance
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.rollout.weighted_problem import WeightedProblem
from avrare_estimators.ce.config import CeConfig, NetworkFamilyConfig
from avrare_estimators.ce.gaussian_family import most_nats
from avrare_estimators.ce.tilted_perception import (
    Tilt,
    TrainingBatch,
    network_inputs,
    residuals,
)
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import PerceptionSource, Source


def _training_batch(sample: Sample, rows: Integers, weights: Floats, target: Any) -> TrainingBatch:
    """Collect the observations along ``rows`` of a sample; the rows' weights add up to 1."""
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


class NetworkFamily:
    """Tilts of the target's perception; needs torch to learn, not to run.

    Raises:
        PluginError: torch is not installed.
    """

    def __init__(self, config: CeConfig, options: NetworkFamilyConfig) -> None:
        if importlib.util.find_spec("torch") is None:
            raise PluginError(
                "the network family of estimator 'ce' needs torch", "pip install 'avrare-estimators[torch]'"
            )
        self.config, self.options = config, options
        self.target: Any = None

    def prepare(self, problem: Problem) -> Problem:
        """Return the closed loop that can be drawn from tilted perception."""
        prepared = WeightedProblem(problem, needs="law")
        self.target = prepared.system.target.perception  # type: ignore[attr-defined]
        return prepared

    def start(self) -> Source:
        """Return the target itself."""
        return PerceptionSource()

    def with_details(self, source: Source) -> Source:
        """Return the same source with the carries to learn from: of every step, as far as memory is given."""
        assert isinstance(source, PerceptionSource)
        config = self.config
        most = 0 if config.memory is None else max(1, allowance(config.memory) // (2 * config.rollouts))
        return replace(source, keep_carries=True, most_bytes=most)

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """Fit the network to the rows' observations by maximum likelihood, starting from the present one."""
        from avrare_estimators.ce.training import train

        source, stratum = sample.source, sample.strata[0]
        assert isinstance(source, PerceptionSource)
        old = source.proposal.network if source.proposal is not None else None
        seeds = np.random.SeedSequence(stratum.plan.noise.seed, spawn_key=(stratum.run, stratum.stage))
        batch = _training_batch(sample, rows, weights, self.target)
        nats = most_nats(sample, self.config.elite)
        seed = int(seeds.generate_state(1)[0])
        return PerceptionSource(Tilt(train(batch, old, self.options, seed, nats)))
