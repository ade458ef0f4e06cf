"""Study of estimators on problems with known answers: do their intervals hold, and what do they cost?

    python -m benchmarks.unseen [--estimator auto] [--sets unseen] [--seeds 100] [--minutes 60]
    python -m benchmarks.unseen report [--sets unseen] [--csv FILE]
    python -m benchmarks.unseen forecast [--sets unseen]
    python -m benchmarks.unseen adopt --estimator ams --digest 1a2b3c4d5e

Sets are those of ``sets.py``, names of problems, and SCENARIO:SPECIFICATION as in ``studies/levels.py``.
``--problems-file`` takes a file of Python with a dict ``CASES`` from names to functions that return a problem
and its probability.

Every result is a line of a file in the results folder, benchmarks/results/unseen. What is there with the same
code of the estimator is not run again, so a study may be stopped and resumed; ``--keep`` packs all lines into
docs/trust/results.zip, with which a new results folder begins. ``adopt`` runs one result of each problem of
other code again: where all are equal to the bit, the results of that code count as of this code.

"""

from __future__ import annotations

import argparse
import ast
import json
import sys
from fnmatch import fnmatch
from itertools import product
from pathlib import Path

from benchmarks.studies import kept

from .problems import CASES
from .report import print_forecast, print_report, write_summary
from .sets import find_names, is_static
from .sources import digest_of
from .study import RESULTS, Task, adopt, find_missing, read_all, run_study

KEPT = Path(__file__).parents[2] / "docs" / "trust" / "results.zip"

NEED_STEPS = {"ams", "smc"}
"""Estimators that are not asked of static problems."""


def main(arguments: list[str]) -> None:
    """Run the study, print its report or forecast the time that it takes."""
    parser = argparse.ArgumentParser("python -m benchmarks.unseen", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("action", nargs="?", choices=["run", "report", "forecast", "adopt"], default="run")
    parser.add_argument("--estimator", default="auto", help="names, separated by commas")
    parser.add_argument("--seeds", type=int, default=100, help="results of each problem")
    parser.add_argument("--sets", default="unseen", help="separated by commas")
    parser.add_argument("--problems", default="*", help="pattern of names")
    parser.add_argument("--problems-file", default="", help="other problems")
    parser.add_argument("--budget", default="", help="of each estimate, as rollouts=100000")
    parser.add_argument("--set", action="append", default=[], metavar="OPTION=VALUE", help="of the estimator")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no result after these")
    parser.add_argument("--digest", default="", help="by default that of the estimator's code")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder")
    parser.add_argument("--keep", action="store_true", help=f"pack the results into {KEPT.name}")
    parser.add_argument("--csv", type=Path, help="file for a row of every problem, of all code")
    given = parser.parse_args(arguments)
    pairs = (setting.split("=", 1) for setting in given.set)
    options = {key: ast.literal_eval(value) for key, value in pairs}
    text, file = json.dumps(options, sort_keys=True), given.problems_file
    names = [name for name in find_names(given.sets, file) if fnmatch(name, given.problems)]
    estimators, static = given.estimator.split(","), {name for name in names if is_static(name, file)}
    tasks = [
        Task(given.digest or digest_of(estimator), name, estimator, seed, given.budget, text)
        for seed, estimator, name in product(range(given.seeds), estimators, names)
        if not (estimator in NEED_STEPS and name in static)
    ]
    kept.unpack(KEPT, given.results)
    outcomes = read_all(given.results)
    missing, wanted = find_missing(tasks, outcomes), set(tasks)
    if given.action == "forecast":
        print_forecast(missing, outcomes)
        return
    if given.action == "adopt":
        other = [outcome for outcome in outcomes if outcome.task in wanted]
        adopt(other, digest_of(given.estimator), given.results, file)
        return
    if given.action == "run":
        run_study(missing, given.results, file, given.processes, given.minutes)
    chosen = [outcome for outcome in read_all(given.results) if outcome.task in wanted]
    hidden = {name for name, case in CASES.items() if case.hidden}
    for estimator in estimators:
        print_report(
            estimator, [outcome for outcome in chosen if outcome.task.estimator == estimator], hidden
        )
    if given.keep:
        kept.pack(KEPT, given.results)
    if given.csv:
        write_summary(given.csv, read_all(given.results))


if __name__ == "__main__":
    main(sys.argv[1:])
