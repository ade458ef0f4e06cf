"""Gain and coverage of ``mfmc`` on pairs of verdicts with a known correlation: docs/two-fidelities.md.

Usage:
    python -m benchmarks.two_fidelities [--seeds 200] [--probability 1e-2] [--rollouts 10000]
"""

from __future__ import annotations

import argparse
import math
from statistics import NormalDist
from typing import Any

import numpy as np
from scipy.special import ndtr

import avrare
from avrare.base.special_functions import bisect
from avrare.protocols import Floats


class Turned:
    """Static system that fails where its noise is long in one direction."""

    noise_size = 2

    def __init__(self, cosine: float) -> None:
        self.cosine = cosine

    def initial(self, noise: Floats) -> dict[str, Floats]:
        """Return the noise as state."""
        return {"u": noise}

    def step(self, state: dict[str, Floats], noise: Floats) -> dict[str, Floats]:
        """Return the state unchanged."""
        return state

    def signals(self, state: dict[str, Floats]) -> dict[str, Floats]:
        """Return ``x`` (N,), standard normal."""
        u = state["u"]
        return {"x": self.cosine * u[:, 0] + math.sqrt(1.0 - self.cosine**2) * u[:, 1]}


def correlate(cosine: float, limit: float) -> float:
    """Return the correlation of two verdicts whose signals have this correlation."""
    x = np.linspace(limit, limit + 9.0, 40_001)
    density = np.exp(-x * x / 2.0) / math.sqrt(2.0 * math.pi)
    both = np.trapezoid(density * ndtr((cosine * x - limit) / math.sqrt(1.0 - cosine**2)), x)
    p = float(ndtr(-limit))
    return float((both - p * p) / (p - p * p))


def measure(p: float, correlation: float, cost: float, rollouts: int, seeds: int) -> str:
    """Return a row of the table."""
    limit = NormalDist().inv_cdf(1.0 - p)
    cosine = bisect(lambda one: correlate(one, limit), correlation, 0.0, 1.0 - 1e-13)
    below = avrare.stl(f"always (x < {limit})")
    stack, twin = (avrare.Problem(Turned(one), below, steps=0) for one in (1.0, cosine))
    pair = stack.with_twin(twin, cost)
    results: list[Any] = [
        avrare.estimate(pair, "mfmc", seed=seed, rollouts=rollouts) for seed in range(seeds)
    ]
    values = np.array([one.probability for one in results])
    covered = np.mean([one.interval[0] <= p <= one.interval[1] for one in results])
    gain = p * (1.0 - p) / rollouts / np.mean((values - p) ** 2)
    theory = (math.sqrt(1.0 - correlation**2) + math.sqrt(cost * correlation**2)) ** -2
    error = values.std() / p / math.sqrt(seeds)
    mean = f"{values.mean() / p:.3f} ± {error:.3f}"
    return f"| {p:g} | {correlation} | {cost} | {mean} | {covered:.3f} | {gain:.1f} | {theory:.1f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--probability", type=float, default=1e-2)
    parser.add_argument("--rollouts", type=int, default=10_000)
    args = parser.parse_args()
    for correlation in (0.9, 0.99):
        for cost in (0.01, 0.1):
            print(measure(args.probability, correlation, cost, args.rollouts, args.seeds), flush=True)


if __name__ == "__main__":
    main()
