"""``avrare falsify``: search for a failure, then for the most likely one."""

from __future__ import annotations

import argparse
from typing import Any

from avrare.analysis.failures.failure import record_failure
from avrare.analysis.failures.falsify import BUDGET, falsify
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.failure_output import progress_line, store_failure
from avrare.cli.output import print_warnings, say
from avrare.report.terminal.failure_text import describe_falsification
from avrare.rollout.loaded_scenario import load


def execute(args: argparse.Namespace) -> int:
    """Search, print and store the failure; return exit code 1 if one was found, else 0."""
    scenario = load(args.scenario, args.set)
    print_warnings(scenario.definition.warnings)
    name = _specification(args, scenario)
    problem = scenario.problem(name)
    with progress_line() as progress:
        found = falsify(problem, args.seed, BUDGET if args.budget is None else args.budget, progress)
    say(f"{scenario.name}: {name}")
    for line in describe_falsification(problem, found):
        say(line)
    if found.noise is not None:
        store_failure(args, record_failure(scenario, name, found.noise))
    return int(ExitCode.PASS if found.noise is None else ExitCode.FAIL)


def _specification(args: argparse.Namespace, scenario: Any) -> str:
    names = scenario.specifications
    if args.specification is None and len(names) > 1:
        raise UsageError("--specification is required", f"one of: {', '.join(names)}")
    return args.specification or names[0]  # type: ignore[no-any-return]
