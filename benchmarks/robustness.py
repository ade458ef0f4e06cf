"""Distribution of the robustness of each rule over Monte Carlo rollouts of a scenario.

python benchmarks/robustness.py [SCENARIO] [ROLLOUTS] [WORKERS]
"""

from __future__ import annotations

import sys

import numpy as np

from avrare.estimation.loop import Settings, run
from avrare.estimation.monte_carlo import MonteCarlo
from avrare.estimation.monte_carlo_config import McConfig
from avrare.rollout.executors.processes import ProcessExecutor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

QUANTILES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 1.0)


def main(path: str, rollouts: int, workers: int) -> None:
    """Print failures, counters and quantiles."""
    scenario = LoadedScenario(load(path))
    problem = scenario.problem(scenario.specifications)
    estimator = MonteCarlo(McConfig(rollouts=rollouts))
    results = run(problem, estimator, ProcessExecutor(workers), Settings(seed=scenario.definition.seed))
    print(f"{path}: {rollouts} rollouts, errors {results[0].errors}, {results[0].counts}")
    print(f"{'specification':20s} failures  " + " ".join(f"{q:>7.0%}" for q in QUANTILES))
    for result in results:
        values = np.nanquantile(result.robustness, QUANTILES)
        row = " ".join(f"{value:7.3f}" for value in values)
        print(f"{result.specification:20s} {result.failures.count:8d}  {row}")


if __name__ == "__main__":
    words = sys.argv[1:]
    main(
        words[0] if words else "scenarios/lane_change_published.yaml",
        int(words[1]) if len(words) > 1 else 1000,
        int(words[2]) if len(words) > 2 else 2,
    )
