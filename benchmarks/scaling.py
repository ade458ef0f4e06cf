"""Do two workers do the work of one in half the time? Beside two bare processes, in one run.

    OMP_NUM_THREADS=1 python benchmarks/scaling.py [ROLLOUTS]

Each line is wall time for the same rollouts of the lane change: in this process, on two workers, and in two
processes that know nothing of each other, which is what the machine allows. Starting up (imports, loading the
compiled solver) is not counted: every process has driven a small batch before the clock starts.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Callable
from multiprocessing.synchronize import Barrier

import numpy as np

from avrare.rollout.executors.processes import ProcessExecutor
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor, Work
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.scenario.load import load

SCENARIO = "scenarios/lane_change_published.yaml"
SETTINGS = ["controller.backend=riccati", "chunk=250"]
REPEATS = 3


def problem() -> Problem:
    """Return the lane change with all its rules."""
    scenario = LoadedScenario(load(SCENARIO, SETTINGS))
    return scenario.problem(scenario.specifications)


def chunks(first: int, rollouts: int, size: int) -> list[Request]:
    """Return rollouts ``first`` and following, in chunks."""
    index = np.arange(first, first + rollouts)
    whole = Request.from_start(np.zeros_like(index), index)
    return [whole.slice(at, at + size) for at in range(0, rollouts, size)]


def drive(executor: Executor, task: Problem, rollouts: int) -> float:
    """Return seconds for the rollouts, without the start."""
    executor.open(Work(task, NoiseSource(0, task.noise_size), scored=False))
    try:
        list(executor.map(chunks(0, 8 * 25, 25)))  # every worker gets some
        began = time.perf_counter()
        list(executor.map(chunks(0, rollouts, task.chunk)))
        return time.perf_counter() - began
    finally:
        executor.close()


def bare(first: int, rollouts: int, barrier: Barrier) -> None:
    """Run one of two processes on its own."""
    task = problem()
    work = Work(task, NoiseSource(0, task.noise_size), scored=False)
    work.run(chunks(0, 25, 25)[0])
    barrier.wait()
    for chunk in chunks(first, rollouts, task.chunk):
        work.run(chunk)
    barrier.wait()


def side_by_side(rollouts: int) -> float:
    """Return seconds of two bare processes with half of the rollouts each."""
    context = multiprocessing.get_context("spawn")
    barrier, half = context.Barrier(3), rollouts // 2
    processes = [context.Process(target=bare, args=(i * half, half, barrier)) for i in (0, 1)]
    for process in processes:
        process.start()
    barrier.wait()
    began = time.perf_counter()
    barrier.wait()
    seconds = time.perf_counter() - began
    for process in processes:
        process.join()
    return seconds


def main(rollouts: int) -> None:
    """Time each way in turn, several times; the fastest of each counts, as the machine has other work too."""
    task = problem()
    ways: dict[str, Callable[[], float]] = {
        "one process": lambda: drive(SerialExecutor(), task, rollouts),
        "two workers": lambda: drive(ProcessExecutor(2), task, rollouts),
        "two bare processes": lambda: side_by_side(rollouts),
    }
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(REPEATS):
        for name, way in ways.items():
            best[name] = min(best[name], way())
    for name, seconds in best.items():
        share = seconds / best["one process"]
        print(f"{name:20s} {seconds:7.2f} s  {rollouts / seconds:7.1f} a second  {share:.2f} of one")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3000)
