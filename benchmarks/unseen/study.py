"""Study of an estimator on problems that nobody tuned it on: run it, and keep a line for each result."""

from __future__ import annotations

import json
import multiprocessing
import os
import runpy
import subprocess
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import avrare
from benchmarks.studies import kept

from .problems import CASES
from .truths import stored

RESULTS = Path(__file__).parents[1] / "results" / "unseen"
Makers = dict[str, Callable[[], tuple[avrare.Problem, float]]]


class Task(NamedTuple):
    """One estimate to run, at a commit and with a budget such as "rollouts=100000" (empty: none)."""

    commit: str
    problem: str
    estimator: str
    seed: int
    budget: str


@dataclass(frozen=True)
class Outcome:
    """One estimate.

    Attributes:
        task: What was run.
        truth: Exact probability.
        probability: Estimate.
        low: Lower end of the interval.
        high: Upper end.
        cost: Cost in complete rollouts: simulated steps over those of a rollout.
        used: Cost over the budget, if there is one.
        seconds: Wall time [s].
        warnings: Names of the health warnings; an error is one, too.
    """

    task: Task
    truth: float
    probability: float
    low: float
    high: float
    cost: float
    used: float | None
    seconds: float
    warnings: list[str]

    @property
    def covers(self) -> bool:
        """True where the interval covers the truth."""
        return self.low <= self.truth <= self.high

    @property
    def misses(self) -> bool:
        """True where the interval misses the truth by more than a factor of three."""
        return self.high * 3.0 < self.truth or self.low > self.truth * 3.0


def read_outcomes(file: Path) -> list[Outcome]:
    """Return the results of a file."""
    return [Outcome(Task(*line.pop("task")), **line) for line in kept.lines(file)]


def find_commit() -> str:
    """Return the commit that is checked out."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@cache
def load_problems(file: str = "") -> Makers:
    """Return functions that make each problem with its probability, by name; of the forty without a file."""
    if file:
        return dict(runpy.run_path(file)["CASES"])
    return {name: lambda name=name: (CASES[name].problem(), stored()[name]) for name in CASES}


def run_task(task: Task, file: str = "") -> Outcome:
    """Run one estimate; an error is a warning of an outcome that says nothing."""
    problem, truth = load_problems(file)[task.problem]()
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = avrare.estimate(problem, task.estimator, seed=task.seed, budget=task.budget or None)
    except Exception as error:
        seconds, name = time.perf_counter() - start, f"{type(error).__name__}: {error}"
        return Outcome(task, truth, 0.0, 0.0, 1.0, 0.0, None, seconds, [name])
    kind, _, amount = task.budget.partition("=")
    costs = {"steps": result.simulated_steps, "rollouts": result.rollouts, "seconds": result.seconds}
    used = costs[kind] / float(amount) if amount else None
    cost = result.simulated_steps / problem.steps if problem.steps else result.rollouts
    interval = (float(end) for end in result.interval)
    seconds, names = time.perf_counter() - start, list(result.health)
    return Outcome(task, truth, float(result.probability), *interval, float(cost), used, seconds, names)


def run_study(tasks: Iterable[Task], folder: Path, file: str, processes: int) -> None:
    """Run the tasks that the results folder lacks, and append a line for each."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    folder.mkdir(parents=True, exist_ok=True)
    done = {outcome.task for path in folder.glob("*.jsonl") for outcome in read_outcomes(path)}
    missing = [task for task in tasks if task not in done]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        outcomes = pool.imap_unordered(partial(run_task, file=file), missing)
        for number, outcome in enumerate(outcomes, start=1):
            with (folder / f"{outcome.task.estimator}.jsonl").open("a", encoding="utf-8") as lines:
                lines.write("\n" + json.dumps(asdict(outcome)))  # a torn line stays alone
            ratio, names = outcome.probability / outcome.truth, " ".join(outcome.warnings)
            text = f"{outcome.task.problem} {outcome.task.estimator} seed {outcome.task.seed}: {ratio:.2f} p"
            print(f"{number}/{len(missing)} {text}, {outcome.seconds:.0f} s {names}", flush=True)
