"""Adapter of VerifAI: its cross-entropy sampler over a unit box, and its Clopper-Pearson interval.

The falsifier's server and client are left out; sampler, feedback and interval are those of its falsifier.
"""

from __future__ import annotations

import random
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.special import ndtri
from statsmodels.stats.proportion import proportion_confint
from verifai.features import Box, Feature, FeatureSpace
from verifai.samplers import FeatureSampler

from benchmarks.calibration.answer import Answer, Counted


def tool_version() -> str:
    """Return the version of VerifAI."""
    return version("verifai")


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return the share of counterexamples, with the interval that its falsifier gives for it."""
    random.seed(seed)
    np.random.seed(seed)
    space = FeatureSpace({"z": Feature(Box(*[(0.0, 1.0)] * counted.problem.dimension))})
    sampler, rho, failures = FeatureSampler.crossEntropySamplerFor(space), None, 0
    for _ in range(budget):
        sample = sampler.nextSample(rho)
        tape = ndtri(np.clip(np.array(sample.z, dtype=float), 1e-16, 1.0 - 1e-16))
        rho = float(counted.robustness(tape[None])[0])
        failures += rho <= 0.0
    low, high = proportion_confint(failures, budget, alpha=0.05, method="beta")
    return Answer(failures / budget, (float(np.nan_to_num(low)), float(high)))
