"""``avrare kinds``: the failures of a run, sorted into kinds with probabilities."""

from __future__ import annotations

import argparse

import numpy as np

from avrare.analysis.causes.kind_descriptions import describe_kinds
from avrare.analysis.causes.kinds import Kinds, find_kinds
from avrare.analysis.failures.shrink import BUDGET
from avrare.base.errors import UsageError
from avrare.cli.failure_output import progress_line
from avrare.cli.output import print_warnings, show_or_write
from avrare.results.run import Run
from avrare.results.stored_causes import KINDS_FILE
from avrare.results.stored_failures import select_failing


def execute(args: argparse.Namespace) -> None:
    """Sort the failures of each specification, print the kinds and write them."""
    if args.budget is not None and not args.shrink:
        raise UsageError("--budget requires --shrink", "it bounds the rollouts that shrink a failure")
    run = Run.read(args.folder)
    print_warnings((line, None) for line in run.changes)
    found = {name: _find(run, name, args) for name in select_failing(run, args.specification)}
    content = {
        "kinds": {
            name: {
                "probability": kinds.result.probability,
                "kinds": list(kinds.table()),
                "points": np.round(kinds.points, 4).tolist(),
                "labels": kinds.labels.tolist(),
            }
            for name, kinds in found.items()
        }
    }
    lines = [line for kinds in found.values() for line in kinds.lines()]
    show_or_write(args, KINDS_FILE, content, lines)


def _find(run: Run, name: str, args: argparse.Namespace) -> Kinds:
    result, problem = run[name], run.scenario.problem(name)
    kinds = find_kinds(result, args.max_kinds, args.method)
    if not args.shrink:
        return kinds
    budget = BUDGET if args.budget is None else args.budget
    with progress_line() as progress:
        return describe_kinds(problem, kinds, result.failures.noise, budget, progress)
