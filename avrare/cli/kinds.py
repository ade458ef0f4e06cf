"""``avrare kinds``: the failures of a run, sorted into kinds with probabilities."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.kind_descriptions import describe_kinds
from avrare.analysis.causes.kinds import Kinds, find_kinds
from avrare.analysis.failures.shrink import BUDGET
from avrare.base.errors import UsageError
from avrare.cli.failure_output import progress_line
from avrare.cli.output import print_warnings, show_or_write
from avrare.results.reader import RunFolder, read_run_folder, select_specifications
from avrare.results.stored_causes import KINDS_FILE


def execute(args: argparse.Namespace) -> None:
    """Sort the failures of each specification, print the kinds and write them."""
    if args.budget is not None and not args.shrink:
        raise UsageError("--budget requires --shrink", "it bounds the rollouts that shrink a failure")
    folder = read_run_folder(Path(args.folder))
    print_warnings((line, None) for line in folder.changes)
    found = {name: _find(folder, name, args) for name in select_specifications(folder, args.specification)}
    content = {
        "kinds": {
            name: {
                "probability": kinds.probability,
                "kinds": list(kinds.table()),
                "points": np.round(kinds.points, 4).tolist(),
                "labels": kinds.labels.tolist(),
            }
            for name, kinds in found.items()
        }
    }
    lines = [line for kinds in found.values() for line in kinds.lines()]
    show_or_write(args, KINDS_FILE, content, lines)


def _find(folder: RunFolder, name: str, args: argparse.Namespace) -> Kinds:
    estimate = next(one for one in folder.result.estimates if one.specification == name)
    sample = FailureSample.stored(estimate, folder.failures[name])
    problem = folder.require_scenario().problem(name)
    kinds = find_kinds(problem, sample, estimate.interval, max_kinds=args.max_kinds, method=args.method)
    if not args.shrink:
        return kinds
    budget = BUDGET if args.budget is None else args.budget
    with progress_line() as progress:
        return describe_kinds(problem, kinds, folder.failures[name].noise, budget, progress)
