"""Study of an estimator on problems that nobody tuned it on.

    python -m benchmarks.unseen --estimator auto --seeds 100 [--problems 'a*'] [--processes 2]
    python -m benchmarks.unseen report [--estimator auto] [--commit 1a2b3c4]

Every result is a line of a file in the results folder, benchmarks/results/unseen. What is there of the same
commit and budget is not run again, so a study may be stopped and resumed. ``--problems-file`` takes another
file of Python with a dict ``CASES`` from names to functions that return a problem and its probability.
"""

from __future__ import annotations

import argparse
import sys
from fnmatch import fnmatch
from itertools import product
from pathlib import Path

from .problems import CASES
from .report import print_report
from .study import RESULTS, Task, find_commit, load_problems, read_outcomes, run_study


def main(arguments: list[str]) -> None:
    """Run the study or print its report."""
    parser = argparse.ArgumentParser("python -m benchmarks.unseen", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
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
        outcomes = [
            outcome
            for outcome in read_outcomes(options.results / f"{estimator}.jsonl")
            if outcome.task.problem in names
            and (outcome.task.commit, outcome.task.budget) == (commit, options.budget)
        ]
        print_report(estimator, outcomes, {name for name, case in CASES.items() if case.hidden})


if __name__ == "__main__":
    main(sys.argv[1:])
