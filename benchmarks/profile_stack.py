"""Where a closed-loop simulation spends its time: seconds and shares by part, on one core.

    OMP_NUM_THREADS=1 python benchmarks/profile_stack.py [SCENARIO] [ROLLOUTS]

Wraps the parts of the built stack with process-time clocks and runs one chunk after another, as a worker does.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load

PARTS = {
    "simulator": ("simulator", ("reset", "step", "signals", "faults")),
    "perception": ("perception", ("observe",)),
    "tracker": ("tracker", ("start", "update", "predict")),
    "controller": ("controller", ("start", "act")),
}


def main(path: str, rollouts: int) -> None:
    """Profile ``rollouts`` rollouts of a scenario."""
    scenario = BuildableScenario(load(path))
    problem = scenario.problem(scenario.specifications)
    spent: dict[str, float] = defaultdict(float)
    for label, (attribute, methods) in PARTS.items():
        part = getattr(scenario.stack.loop, attribute)
        for method in methods:
            if part is not None and hasattr(part, method):
                setattr(part, method, _timed(getattr(part, method), spent, label))
    for specification in scenario.stack.specifications.values():
        specification.update = _timed(specification.update, spent, "monitors")  # type: ignore[method-assign]
    noise = NoiseSource(0, problem.noise_size)
    noise.normals = _timed(noise.normals, spent, "noise")  # type: ignore[method-assign]
    began = time.process_time()
    for first in range(0, rollouts, problem.chunk):
        index = np.arange(first, min(first + problem.chunk, rollouts))
        problem.simulate(noise, Request.from_start(np.zeros_like(index), index), scored=False)
    total = time.process_time() - began
    spent["bookkeeping"] = total - sum(spent.values())
    print(f"{path}: {total / rollouts:.4f} CPU s a simulation of {problem.steps} steps, {rollouts} rollouts")
    for label, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"  {label:12s} {1e3 * seconds / rollouts:8.2f} ms  {seconds / total:6.1%}")


def _timed(function: Callable[..., Any], spent: dict[str, float], label: str) -> Callable[..., Any]:
    def wrapper(*args: Any, **options: Any) -> Any:
        began = time.process_time()
        try:
            return function(*args, **options)
        finally:
            spent[label] += time.process_time() - began

    return wrapper


if __name__ == "__main__":
    main(
        sys.argv[1] if len(sys.argv) > 1 else "scenarios/lane_change.yaml",
        int(sys.argv[2]) if len(sys.argv) > 2 else 200,
    )
