"""Textbook generalised adaptive multilevel splitting (Brehier et al., 2016, Algorithm 1), in NumPy alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration.answer import Answer, Counted, of_runs
from benchmarks.calibration.problems.problem import Floats


def tool_version() -> str:
    """Return the version of this program."""
    return "1"


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return the mean of ten runs; a run of N particles is given N = budget / 50, and discards a tenth."""
    generator = np.random.default_rng(seed)
    particles = max(budget // 50, 20)
    return of_runs([_run(counted, particles, max(particles // 10, 1), generator) for _ in range(10)])


def _run(counted: Counted, particles: int, discard: int, generator: np.random.Generator) -> float:
    system, rows = counted.problem.system, np.arange(particles)
    states = np.empty((particles, system.steps + 1, len(system.start)))
    tops = np.full((particles, system.steps + 1), -np.inf)
    states[:, 0] = system.start
    _simulate(counted, states, tops, rows, np.zeros(particles, dtype=np.int64), generator)
    weight = 1.0
    while True:
        final = tops[:, -1]
        level = np.sort(final)[discard - 1]
        if level >= 1.0:
            return weight * float((final >= 1.0).mean())
        dead, alive = rows[final <= level], rows[final > level]
        if not len(alive):
            return weight * float((final >= 1.0).mean())
        weight *= len(alive) / particles
        parents = generator.choice(alive, len(dead))
        branch = (tops[parents] > level).argmax(axis=1)
        states[dead], tops[dead] = states[parents], tops[parents]
        _simulate(counted, states, tops, dead, branch, generator)


def _simulate(
    counted: Counted, states: Floats, tops: Floats, rows: NDArray[np.int64], start: NDArray[np.int64],
    generator: np.random.Generator,
) -> None:  # fmt: skip
    """Go on with these rows, each from its own step."""
    system = counted.problem.system
    for t in range(int(start.min()), system.steps):
        going = rows[start <= t]
        noise = generator.standard_normal((len(going), system.noise_size))
        states[going, t + 1] = counted.step(states[going, t], noise)
        tops[going, t + 1] = np.maximum(tops[going, t], system.score(states[going, t + 1]))
