"""Profile of a closed-loop rollout: seconds and shares by part, on one core.

    OMP_NUM_THREADS=1 python benchmarks/profile_stack.py [SCENARIO] [ROLLOUTS] [KEY=VALUE...]

Wraps the parts of the built stack in process-time clocks and runs one chunk after another, as a worker.
Visibility is a part of perception that has its own clock.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from typing import Any

import numpy as np

from avrare.rollout.engine import simulate
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load
from avrare_gp_pem.runtime import models

PARTS = ("simulator", "perception", "tracker", "controller")


class Timed:
    """A part whose methods add their CPU time to ``spent[label]``."""

    def __init__(self, part: Any, spent: dict[str, float], label: str) -> None:
        self._part, self._spent, self._label = part, spent, label

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._part, name)
        if not callable(value):
            return value

        def timed(*args: Any) -> Any:
            began = time.process_time()
            try:
                return value(*args)
            finally:
                self._spent[self._label] += time.process_time() - began

        return timed


def main(path: str, rollouts: int, settings: list[str]) -> None:
    """Profile ``rollouts`` rollouts of a scenario."""
    scenario = LoadedScenario(load(path, settings))
    problem, loop = scenario.problem(scenario.specifications), scenario.stack.loop
    simulate(
        loop, problem.monitors, 1, NoiseSource(0, problem.noise_size), _rollouts(0, 1)
    )  # loads and compiles
    spent: dict[str, float] = defaultdict(float)
    _time_visibility(spent)
    for name in PARTS:
        if getattr(loop, name) is not None:
            setattr(loop, name, Timed(getattr(loop, name), spent, name))
    monitors = tuple(Timed(spec, spent, "monitors") for spec in scenario.stack.specifications.values())
    noise: Any = Timed(NoiseSource(0, problem.noise_size), spent, "noise")
    began = time.process_time()
    for first in range(0, rollouts, problem.chunk):
        simulate(loop, monitors, problem.steps, noise, _rollouts(first, min(first + problem.chunk, rollouts)))
    total = time.process_time() - began
    spent["perception"] -= spent["visibility"]
    spent["bookkeeping"] = total - sum(spent.values())
    print(f"{path}: {total / rollouts:.4f} CPU s a simulation of {problem.steps} steps, {rollouts} rollouts")
    for label, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"  {label:12s} {1e3 * seconds / rollouts:8.2f} ms  {seconds / total:6.1%}")


def _time_visibility(spent: dict[str, float]) -> None:
    models.visibility = Timed(models, spent, "visibility").visibility  # type: ignore[attr-defined]


def _rollouts(first: int, end: int) -> Request:
    index = np.arange(first, end)
    return Request.from_start(np.zeros_like(index), index)


if __name__ == "__main__":
    main(
        sys.argv[1] if len(sys.argv) > 1 else "scenarios/lane_change_published.yaml",
        int(sys.argv[2]) if len(sys.argv) > 2 else 200,
        sys.argv[3:],
    )
