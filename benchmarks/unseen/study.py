"""Study of an estimator on problems with known answers: run it, and keep a line for each result."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import time
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import avrare
from avrare.analysis.check.criteria import Criterion, decide_criteria
from avrare.scenario.schema import Threshold
from benchmarks.studies import kept

from .sets import find_problem

RESULTS = Path(__file__).parents[1] / "results" / "unseen"


class Task(NamedTuple):
    """One estimate to run.

    Attributes:
        digest: Digest of the estimator's code.
        problem: Name.
        estimator: Name.
        seed: Seed.
        budget: Such as "rollouts=100000"; empty: none.
        options: Of the estimator, as JSON.
    """

    digest: str
    problem: str
    estimator: str
    seed: int
    budget: str = ""
    options: str = "{}"


@dataclass(frozen=True)
class Outcome:
    """One estimate.

    Attributes:
        task: What was run.
        truth: Known probability.
        probability: Estimate.
        low: Lower end of the interval.
        high: Upper end.
        cost: Cost in complete rollouts: simulated steps over those of a rollout.
        used: Cost over the budget, if there is one.
        seconds: CPU time [s].
        warnings: Names of the health warnings; an error is one, too.
        verdict: Of ``avrare check`` on a threshold at exactly the truth.
        chosen: Estimator that ``auto`` has chosen.
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
    verdict: str = "inconclusive"
    chosen: str = ""

    @property
    def covers(self) -> bool:
        """True where the interval covers the truth."""
        return self.low <= self.truth <= self.high

    @property
    def misses(self) -> bool:
        """True where the interval misses the truth by more than a factor of three."""
        return self.high * 3.0 < self.truth or self.low > self.truth * 3.0

    @property
    def misleads(self) -> bool:
        """True where it does so without a warning."""
        return self.misses and not self.warnings

    @property
    def passes(self) -> bool:
        """True where a threshold at exactly the truth passes."""
        return self.verdict.startswith("pass")

    @property
    def ratio(self) -> float:
        """Estimate over the truth."""
        return self.probability / self.truth

    @property
    def end_ratio(self) -> float:
        """Upper over lower end of the interval."""
        return self.high / self.low if self.low > 0.0 else math.inf


def read_outcomes(file: Path) -> list[Outcome]:
    """Return the results of a file."""
    return [Outcome(Task(*line.pop("task")), **line) for line in kept.lines(file)]


def read_all(folder: Path) -> list[Outcome]:
    """Return the results of a folder."""
    return [outcome for path in sorted(folder.glob("*.jsonl")) for outcome in read_outcomes(path)]


def run_task(task: Task, file: str = "") -> Outcome:
    """Run one estimate; an error is a warning of an outcome that says nothing."""
    problem, truth = find_problem(task.problem, file)
    options, start = json.loads(task.options), time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = avrare.estimate(
                problem, task.estimator, seed=task.seed, budget=task.budget or None, **options
            )
    except Exception as error:
        seconds, name = time.process_time() - start, f"{type(error).__name__}: {error}"
        return Outcome(task, truth, 0.0, 0.0, 1.0, 0.0, None, seconds, [name])
    kind, _, amount = task.budget.partition("=")
    costs = {"steps": result.simulated_steps, "rollouts": result.rollouts, "seconds": result.seconds}
    used = costs[kind] / float(amount) if amount else None
    cost = result.simulated_steps / problem.steps if problem.steps else result.rollouts
    low, high = map(float, result.interval)
    seconds, names = time.process_time() - start, list(result.health)
    verdict = decide_at(result, truth)
    estimate = float(result.probability)
    return Outcome(
        task, truth, estimate, low, high, float(cost), used, seconds, names, verdict, result.estimator
    )


def decide_at(result: avrare.Result, probability: float) -> str:
    """Return the verdict of ``avrare check`` on a threshold, after one look."""
    threshold = Threshold.model_validate({"specification": result.specification, "probability": probability})
    criterion = Criterion("", result.specification, threshold)
    return decide_criteria([criterion], lambda _: result, 1.0, {}).get(0, "inconclusive")


def adopt(outcomes: Sequence[Outcome], digest: str, folder: Path, file: str) -> None:
    """Count results of other code as of this code, once one of each problem has been run again.

    Args:
        outcomes: Results of the other code, of one estimator.
        digest: Digest of this code.
        folder: Of the results, where the adopted ones are appended.
        file: Of the problems.

    Raises:
        ValueError: A result differs.
    """
    for outcome in {outcome.task.problem: outcome for outcome in outcomes}.values():
        again = run_task(outcome.task, file)
        if replace(again, seconds=outcome.seconds, chosen=outcome.chosen) != outcome:
            raise ValueError(f"{outcome.task.problem} seed {outcome.task.seed} differs: run the study anew")
        print(f"{outcome.task.problem} seed {outcome.task.seed}: equal", flush=True)
    for outcome in outcomes:
        _append(replace(outcome, task=outcome.task._replace(digest=digest)), folder)


def _append(outcome: Outcome, folder: Path) -> None:
    with (folder / f"{outcome.task.estimator}.jsonl").open("a", encoding="utf-8") as lines:
        lines.write("\n" + json.dumps(asdict(outcome)))  # a torn line stays alone


def find_missing(tasks: Iterable[Task], outcomes: Iterable[Outcome]) -> list[Task]:
    """Return the tasks without a result."""
    done = {outcome.task for outcome in outcomes}
    return [task for task in tasks if task not in done]


def run_study(tasks: Sequence[Task], folder: Path, file: str, processes: int, minutes: float = 1e9) -> None:
    """Run tasks until so many minutes are over, and append a line to the file of the estimator for each."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + 60.0 * minutes
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        outcomes = pool.imap_unordered(partial(run_task, file=file), tasks)
        for number, outcome in enumerate(outcomes, start=1):
            _append(outcome, folder)
            problem, names = outcome.task.problem, " ".join(outcome.warnings)
            text = f"{problem} {outcome.task.estimator} seed {outcome.task.seed}: {outcome.ratio:.2f} p"
            print(f"{number}/{len(tasks)} {text}, {outcome.seconds:.1f} s {names}", flush=True)
            if time.monotonic() > end:
                break
