"""Gain of the score `progress` on formulas that may still come true (docs/statistics.md).

    python benchmarks/scores.py [RUNS]

Independent splitting runs of 100 particles, 10 discarded, on problems with exact answers: mean over truth,
extinct share, and relative mean squared error times cost beside Monte Carlo's.
"""

from __future__ import annotations

import sys

import avrare
from avrare.testing.problems import reach, response

PARTICLES, DISCARD, SEED = 100, 10, 3


PROBLEMS = [
    reach(0.25), reach(0.5), reach(1.0),
    response(within=40), response(within=60), response(within=80),
]  # fmt: skip


def study(problem: avrare.Problem, steps: int, truth: float, runs: int) -> str:
    """Return one row of the table."""
    result = avrare.estimate(problem, "ams", particles=PARTICLES, discard=DISCARD, runs=runs, seed=SEED)
    ratio = result.run_probabilities / truth
    error, cost = ratio.std(ddof=1) / runs**0.5, result.simulated_steps / steps / runs
    gain = float(((ratio - 1.0) ** 2).mean() * cost)
    extinct = float((ratio == 0.0).mean())
    crude = (1.0 - truth) / truth
    return f"{ratio.mean():6.3f} +- {error:.3f}  {extinct:7.1%}  {cost:6.0f}  {gain:8.0f}  {crude:8.0f}"


def main(runs: int) -> None:
    print(f"{'problem':58s} {'score':10s}  mean/true       extinct    cost  MSE*cost        MC")
    for reference in PROBLEMS:
        scores = {"progress": None, "hand-made": reference.score, "robustness": "robustness"}
        for name, score in scores.items():
            problem = avrare.Problem(reference.system, avrare.stl(reference.formula), reference.steps, score)
            row = study(problem, reference.steps, reference.probability, runs)
            print(f"{reference.formula:58s} {name:10s}  {row}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
