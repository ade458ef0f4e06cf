"""Overhead of Ray on chunks of about a second, beside the core's own processes, in one run.

    OMP_NUM_THREADS=1 python benchmarks/ray_overhead.py [CHUNKS]

Needs Ray (plugins/avrare-ray/README.md). Each way has its workers and their problem in memory before the
clock starts; the fastest of three turns counts, as the machine has other work too. Outcomes must be the same.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

import avrare
from avrare.rollout.executors.processes import ProcessExecutor
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor, Work
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.testing.faulty_systems import Walk
from avrare_ray.config import RayConfig
from avrare_ray.executor import build as ray

STEPS, ROWS, WORKERS, TURNS = 300, 25_000, 2, 3


def requests(count: int, rows: int) -> list[Request]:
    """Return chunks of so many rollouts each."""
    index = np.arange(count * rows)
    whole = Request.from_start(np.zeros_like(index), index)
    return [whole.slice(at, at + rows) for at in range(0, len(index), rows)]


def turn(executor: Executor, work: Work, count: int) -> tuple[float, bytes]:
    """Return seconds for ``count`` chunks, and what came out."""
    executor.open(work)
    try:
        list(executor.map(requests(4 * WORKERS, 50)))
        began = time.perf_counter()
        outcomes = list(executor.map(requests(count, ROWS)))
        return time.perf_counter() - began, b"".join(one.robustness.tobytes() for one in outcomes)
    finally:
        executor.close()


def main(count: int) -> None:
    """Print a line for each way."""
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 2.5)"), STEPS)
    work = Work(problem, NoiseSource(0, 1), scored=False)
    single, first = turn(SerialExecutor(), work, 2)
    print(f"a chunk takes {single / 2:.2f} s in one process")
    ways: dict[str, Callable[[], Executor]] = {
        "processes": lambda: ProcessExecutor(WORKERS),
        "ray": lambda: ray(RayConfig(workers=WORKERS)),
    }
    best: dict[str, float] = {}
    for _ in range(TURNS):
        for name, make in ways.items():
            seconds, outcome = turn(make(), work, count)
            assert outcome.startswith(first), f"{name} gives another outcome"
            best[name] = min(best.get(name, np.inf), seconds)
    for name, seconds in best.items():
        share = seconds / best["processes"]
        print(f"{name:10s} {count} chunks on {WORKERS} workers {seconds:6.2f} s  {share:.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
