"""Cheap twin of a stack: another problem on the same noise tapes."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import System
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.stack.closed_loop import ClosedLoop


@dataclass(frozen=True)
class Twin:
    """Cheap stand-in for a problem: it reads the same tapes and has the same specifications.

    Attributes:
        problem: The problem of the twin.
        cost: Cost of a rollout, in rollouts of the stack itself; estimator "mfmc" needs it.
    """

    problem: Any  # ``avrare.rollout.problem.Problem``, which imports this module
    cost: float | None = None


def check_twin(problem: Any, twin: Any, cost: float | None) -> None:
    """Check that a twin can stand in for a problem.

    Raises:
        UsageError: Their tapes have different shapes, a specification is missing, or the cost is not a share.
    """
    if cost is not None and not 0.0 < cost < 1.0:
        raise UsageError(
            f"the cost of the cheap twin should lie between 0 and 1, not {cost:g}",
            "it is the time of a rollout of the twin over that of the stack itself",
        )
    missing = [name for name in problem.names if name not in twin.names]
    if missing:
        raise UsageError(
            f"the cheap twin has no specification {', '.join(missing)}",
            "give it the specifications of the stack, by the same names",
        )
    if (problem.steps, problem.noise_size) != (twin.steps, twin.noise_size):
        raise UsageError(
            f"the cheap twin cannot share its noise with the stack: {_describe_tapes(problem, twin)}",
            "a twin may differ in controller, tracker and options, but each of its steps must read as many "
            "numbers as the stack's, by simulator and by perception",
        )


def _describe_tapes(problem: Any, twin: Any) -> str:
    differences = []
    if problem.steps != twin.steps:
        differences.append(f"{twin.steps} steps instead of {problem.steps}")
    parts, others = _sizes(problem.system), _sizes(twin.system)
    for name in dict.fromkeys((*parts, *others)):
        if parts.get(name, 0) != others.get(name, 0):
            differences.append(
                f"{name} reads {others.get(name, 0)} numbers a step instead of {parts.get(name, 0)}"
            )
    return "; ".join(differences)


def _sizes(system: System) -> dict[str, int]:
    """Return the noise numbers of each part of a system."""
    if not isinstance(system, ClosedLoop):
        return {"system": system.noise_size}
    drawn = system.world_noise - system.simulator.noise_size
    perception = system.noise_size - system.world_noise
    return {"draws": drawn, "simulator": system.simulator.noise_size, "perception": perception}


def measure_cost(problem: Any, twin: Any) -> float:
    """Return the time of a rollout of a twin over that of the stack, as the nearest power of 2."""
    seconds: dict[int, list[float]] = {0: [], 1: []}
    # In turns, and the least of three: the first pays for compilation, other work on the machine only adds.
    for _ in range(3):
        for which, variant in enumerate((twin, problem)):
            seconds[which].append(_seconds(variant))
    return float(2.0 ** round(math.log2(max(min(seconds[0]) / min(seconds[1]), 2.0**-20))))


def _seconds(problem: Any) -> float:
    noise, rows = NoiseSource(0, problem.noise_size), 1
    long_enough = 0.2  # [s]
    most_rows = 256
    while True:
        request = Request.from_start(np.zeros(rows, dtype=np.int64), np.arange(rows))
        began = time.perf_counter()
        problem.simulate(noise, request, scored=False)
        seconds = time.perf_counter() - began
        if seconds >= long_enough or rows >= min(problem.chunk, most_rows):
            return max(seconds, 1e-9) / rows
        rows = min(problem.chunk, most_rows, 8 * rows)
