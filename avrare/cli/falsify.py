"""``avrare falsify``: search for a failure, then for the most likely one."""

from __future__ import annotations

import argparse

from avrare.analysis.failures.failure import record_failure
from avrare.analysis.failures.falsify import BUDGET, falsify
from avrare.base.errors import ExitCode
from avrare.cli.failure_output import progress_line, store_failure
from avrare.cli.output import print_notes, print_warnings, show
from avrare.rollout.loaded_scenario import load, select_specification


def execute(args: argparse.Namespace) -> int:
    """Search, print and store the failure; return exit code 1 if one was found, else 0."""
    scenario = load(args.scenario, args.set)
    print_warnings(scenario.definition.warnings)
    name = select_specification(scenario.specifications, args.specification, args.scenario)
    budget = BUDGET if args.budget is None else args.budget
    with progress_line(args) as progress:
        search = falsify(scenario.problem(name), seed=args.seed, budget=budget, progress=progress)
    print_notes(args, f"{scenario.name}: {name}")
    show(args, search.table()[0], [search])
    if search.noise is not None:
        store_failure(args, record_failure(scenario, name, search.noise))
    return int(ExitCode.PASS if search.noise is None else ExitCode.FAIL)
