"""OpenTURNS' subset sampling and our splitting on the same problems, at as many evaluations of the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import avrare
from avrare.testing.problems import reference_problem

PROBLEMS = {"d_rw_L3.8": 0.5, "d_rw_L4.8": 0.6, "e_ou_L4.0": 0.75}
"""Problem -> the most that relative MSE x cost of splitting may be of OpenTURNS'."""
REPETITIONS, BLOCK = 500, 50
LEVEL_PROBABILITY, TOGETHER = 0.1, 100
SAMPLES = {"d_rw_L3.8": 2800, "d_rw_L4.8": 1800, "e_ou_L4.0": 3600}
"""Of each level in OpenTURNS: about 11,000 evaluations in all."""
PARTICLES = {"d_rw_L3.8": 360, "d_rw_L4.8": 320, "e_ou_L4.0": 280}
"""Of each of the ten runs of splitting: as many evaluations."""
METHODS = ("ams", "ams-one", "openturns")
"""Ten runs, as is the default; one of ten times as many particles; the peer."""


@dataclass(frozen=True)
class PeerBlock:
    """Repetitions of one method on one problem."""

    method: str
    problem: str
    number: int

    @property
    def cell(self) -> str:
        """Its cell's name."""
        return f"peers-{self.method}-{self.problem}"

    @property
    def file(self) -> str:
        """Path of the outcome."""
        return f"{self.cell}-{self.number:03d}.npz"

    def outcome(self) -> dict[str, Any]:
        """Return estimates and their costs in full simulations."""
        if self.method == "ams-one":
            return single_runs(self.problem, self.number)
        repeat = {"ams": splitting, "openturns": subset_sampling}[self.method]
        pairs = [repeat(self.problem, self.number * BLOCK + i) for i in range(BLOCK)]
        return {"values": np.array([p for p, _ in pairs]), "costs": np.array([cost for _, cost in pairs])}


def blocks() -> Iterator[PeerBlock]:
    """Return all blocks."""
    for problem in PROBLEMS:
        for method in METHODS:
            for number in range(REPETITIONS // BLOCK):
                yield PeerBlock(method, problem, number)


def splitting(name: str, seed: int) -> tuple[float, float]:
    """Return an estimate of ten runs, and its cost in full simulations."""
    reference = reference_problem(name)
    particles = PARTICLES[name]
    result = avrare.estimate(
        reference.problem(), "ams", particles=particles, discard=particles // 10, seed=seed, grow=False
    )
    return result.probability, result.simulated_steps / reference.steps


def single_runs(name: str, seed: int) -> dict[str, Any]:
    """Make a block of estimates of one run each in one call, at their mean cost."""
    reference = reference_problem(name)
    particles = 10 * PARTICLES[name]
    result = avrare.estimate(
        reference.problem(chunk=50_000), "ams", particles=particles, discard=particles // 10, runs=BLOCK,
        seed=10_000 + seed, grow=False,
    )  # fmt: skip
    cost = result.simulated_steps / reference.steps / BLOCK
    return {"values": np.asarray(result.run_probabilities), "costs": np.full(BLOCK, cost)}


def subset_sampling(name: str, seed: int) -> tuple[float, float]:
    """Return OpenTURNS' estimate, NaN where it gives none, and how often it evaluated the model."""
    import openturns

    reference = reference_problem(name)
    problem, steps = reference.problem(), reference.steps
    cost = 0

    def robustness(points: Any) -> Any:
        nonlocal cost
        tape = np.asarray(points, dtype=np.float64)[:, :, None]
        cost += len(tape)
        start = np.zeros((len(tape), 1, 1))
        return problem.robustness(np.concatenate([start, tape], axis=1))[:, None]

    openturns.RandomGenerator.SetSeed(seed)
    openturns.Log.Show(openturns.Log.NONE)
    model = openturns.PythonFunction(steps, 1, func_sample=robustness)
    noise = openturns.RandomVector(openturns.Normal(steps))
    failure = openturns.ThresholdEvent(
        openturns.CompositeRandomVector(openturns.Function(model), noise), openturns.LessOrEqual(), 0.0
    )
    algorithm = openturns.SubsetSampling(failure)
    algorithm.setMaximumOuterSampling(SAMPLES[name] // TOGETHER)
    algorithm.setBlockSize(TOGETHER)
    algorithm.setConditionalProbability(LEVEL_PROBABILITY)
    try:
        algorithm.run()
    except TypeError as error:
        if "variance estimate" not in str(error):
            raise
        return float("nan"), float(cost)  # it stumbles over its own variance estimate at a few seeds
    return float(algorithm.getResult().getProbabilityEstimate()), float(cost)
