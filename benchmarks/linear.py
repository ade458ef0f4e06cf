"""Failure probability of the double integrator from the exact law of its trajectories.

    OMP_NUM_THREADS=1 python benchmarks/linear.py [CHUNKS]

All signals at all samples are drawn from their joint Gaussian law, 100,000 trajectories a chunk, and the
formula is evaluated on each: Monte Carlo without a rollout. 285 chunks take two minutes. For
docs/linear-systems.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import avrare
from avrare.estimation.result.intervals import clopper_pearson
from avrare_linear.gaussian import TrajectoryGaussian

SCENARIO = Path(__file__).parents[1] / "scenarios" / "double_integrator.yaml"
CHUNK = 100_000


def main(chunks: int) -> None:
    """Draw and count."""
    problem = avrare.load(SCENARIO).problem("clear")
    formula = problem.monitors[0].formula  # type: ignore[attr-defined]
    law = TrajectoryGaussian.of(problem.system, problem.steps, formula.signals)
    root = np.linalg.cholesky(law.covariance.reshape(law.mean.size, -1))
    failures, trajectories = 0, CHUNK * chunks
    for chunk in range(chunks):
        normal = np.random.default_rng([1, chunk]).standard_normal((CHUNK, law.mean.size))
        values = law.mean + (normal @ root.T).reshape(-1, *law.mean.shape)
        satisfied = formula.satisfied({name: values[:, :, i] for i, name in enumerate(law.names)})
        failures += int((~satisfied[:, 0]).sum())
    low, high = clopper_pearson(failures, trajectories, 0.95)
    print(f"{failures} of {trajectories:,}: {failures / trajectories:.4g}  95 % {low:.4g} .. {high:.4g}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 285)
