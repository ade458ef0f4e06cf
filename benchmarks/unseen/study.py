"""Study of an estimator on problems that nobody tuned it on.

    python -m benchmarks.unseen --estimator auto --seeds 100 [--problems 'a*'] [--processes 2]
    python -m benchmarks.unseen report [--estimator auto] [--commit 1a2b3c4]

Every result is a line of a file in the results folder, benchmarks/results/unseen. What is there of the same
commit and budget is not run again, so a study may be stopped and resumed. ``--problems-file`` takes another
file of Python with a dict ``CASES`` from names to functions that return a problem and its probability.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import runpy
import subprocess
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from functools import cache, partial
from itertools import product
from pathlib import Path

import avrare

from .problems import CASES
from .truths import stored

RESULTS = Path(__file__).parents[1] / "results" / "unseen"
Makers = dict[str, Callable[[], tuple[avrare.Problem, float]]]


@dataclass(frozen=True)
class Task:
    """One estimate to run.

    Attributes:
        commit: Commit of the code.
        problem: Name of the problem.
        estimator: Name of the estimator.
        seed: Seed of the estimate.
        budget: As "rollouts=100000"; empty: the estimator's own options decide.
    """

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
        blind: Bound of the failures that the score does not lead to.
        cost: Cost in complete rollouts: simulated steps over those of a rollout.
        used: Cost over the budget, if there is one.
        seconds: Wall time [s].
        warnings: Names of the health warnings; an error is one, too.
        chosen: Estimator that ran.
    """

    task: Task
    truth: float
    probability: float
    low: float
    high: float
    blind: float
    cost: float
    used: float | None
    seconds: float
    warnings: tuple[str, ...]
    chosen: str

    @property
    def covers(self) -> bool:
        """Whether the interval covers the truth."""
        return self.low <= self.truth <= self.high

    @property
    def misses(self) -> bool:
        """Whether the interval misses the truth by more than a factor of three."""
        return self.high * 3.0 < self.truth or self.low > self.truth * 3.0


def read_outcomes(folder: Path, estimator: str) -> list[Outcome]:
    """Return the results of an estimator; a torn line is left out."""
    file = folder / f"{estimator}.jsonl"
    outcomes = []
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            fields = json.loads(line)
        except json.JSONDecodeError:
            continue
        fields.update(task=Task(**fields["task"]), warnings=tuple(fields["warnings"]))
        outcomes.append(Outcome(**fields))
    return outcomes


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
    """Run one estimate; an error of the estimator is an outcome without an estimate."""
    problem, truth = load_problems(file)[task.problem]()
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = avrare.estimate(problem, task.estimator, seed=task.seed, budget=task.budget or None)
        except Exception as error:
            seconds = time.perf_counter() - start
            name = f"error: {type(error).__name__}: {error}"
            return Outcome(task, truth, 0.0, 0.0, 1.0, 0.0, 0.0, None, seconds, (name,), task.estimator)
    cost = result.simulated_steps / problem.steps if problem.steps else result.rollouts
    kind, _, amount = task.budget.partition("=")
    costs = {"steps": result.simulated_steps, "rollouts": result.rollouts, "seconds": result.seconds}
    return Outcome(
        task,
        truth,
        float(result.probability),
        *map(float, result.interval),
        float(result.blind_bound or 0.0),
        float(cost),
        costs[kind] / float(amount) if task.budget else None,
        time.perf_counter() - start,
        tuple(result.health),
        result.estimator,
    )


def run_study(tasks: Iterable[Task], folder: Path, file: str, processes: int) -> None:
    """Run the tasks that the results folder lacks, and append a line for each."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    folder.mkdir(parents=True, exist_ok=True)
    missing: list[Task] = []
    done: dict[str, set[Task]] = {}
    for task in tasks:
        if task.estimator not in done:
            done[task.estimator] = {outcome.task for outcome in read_outcomes(folder, task.estimator)}
        if task not in done[task.estimator]:
            missing.append(task)
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        outcomes = pool.imap_unordered(partial(run_task, file=file), missing)
        for number, outcome in enumerate(outcomes, start=1):
            with (folder / f"{outcome.task.estimator}.jsonl").open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(asdict(outcome)) + "\n")
            ratio = outcome.probability / outcome.truth
            print(
                f"{number}/{len(missing)} {outcome.task.problem} {outcome.task.estimator} seed "
                f"{outcome.task.seed}: {ratio:.2f} p, {outcome.seconds:.0f} s, {' '.join(outcome.warnings)}",
                flush=True,
            )


def main(arguments: list[str]) -> None:
    """Run the study or print its report."""
    from .report import print_report

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.unseen",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("action", nargs="?", choices=["run", "report"], default="run")
    parser.add_argument("--estimator", default="auto", help="names, separated by commas")
    parser.add_argument("--seeds", type=int, default=100, help="results of each problem")
    parser.add_argument("--problems", default="*", help="pattern of names")
    parser.add_argument("--problems-file", default="", help="other problems than the forty")
    parser.add_argument("--budget", default="", help="of each estimate, as rollouts=100000")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--commit", default="", help="by default the one that is checked out")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder")
    options = parser.parse_args(arguments)
    commit, estimators = options.commit or find_commit(), options.estimator.split(",")
    names = [name for name in load_problems(options.problems_file) if fnmatch(name, options.problems)]
    if options.action == "run":
        seeds = range(options.seeds)
        tasks = [Task(commit, n, e, seed, options.budget) for seed, e, n in product(seeds, estimators, names)]
        run_study(tasks, options.results, options.problems_file, options.processes)
    for estimator in estimators:
        wanted = [
            outcome
            for outcome in read_outcomes(options.results, estimator)
            if outcome.task.commit == commit
            and outcome.task.budget == options.budget
            and outcome.task.problem in names
        ]
        hidden = {name for name, case in CASES.items() if case.hidden}
        print_report(estimator, wanted, hidden)
