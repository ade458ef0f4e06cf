"""Bias and coverage on a random walk with a known answer, through the public API alone.

    OMP_NUM_THREADS=1 python benchmarks/random_walk.py [SEEDS]      # about eight minutes for 200 seeds

x += 0.1 w for 100 steps; the probabilities that it reaches a limit are from numerical integration.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import avrare

EXACT = {2.5: 1.0618888379037e-2, 3.8: 1.1654634848511e-4}
CASES: list[tuple[str, float, dict[str, Any]]] = [
    ("mc", 2.5, {"rollouts": 2000}),
    ("ams", 2.5, {"particles": 100, "discard": 10, "runs": 10}),
    ("ams", 3.8, {"particles": 100, "discard": 10, "runs": 10}),
]


class Walk:
    """The ten-line system of the README."""

    noise_size = 1

    def initial(self, noise: Any) -> Any:
        """Begin at zero."""
        return {"x": np.zeros(len(noise))}

    def step(self, state: Any, noise: Any) -> Any:
        """Add one increment."""
        return {"x": state["x"] + 0.1 * noise[:, 0]}

    def signals(self, state: Any) -> Any:
        """Return the position."""
        return state


def main(seeds: int) -> None:
    """Run every case for ``seeds`` seeds."""
    for name, limit, options in CASES:
        problem = avrare.Problem(Walk(), avrare.stl(f"always (x < {limit})"), steps=100)
        results = [avrare.estimate(problem, name, seed=seed, **options) for seed in range(seeds)]
        values, exact = np.array([result.probability for result in results]), EXACT[limit]
        error = values.std(ddof=1) / np.sqrt(seeds)
        covered = np.mean([r.interval[0] <= exact <= r.interval[1] for r in results])
        print(
            f"{name:4s} x < {limit}  p {exact:.4g}  mean/true {values.mean() / exact:.4f}"
            f"  z {(values.mean() - exact) / error:+.2f}  coverage {covered:.3f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
