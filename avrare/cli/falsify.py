"""``avrare falsify``: find a failure fast, then the most likely one."""

from __future__ import annotations

import argparse
from typing import Any

from avrare.cli.searching import add_search_arguments, keep, progress
from avrare.errors import ExitCode, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare falsify``."""
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one value")
    parser.add_argument(
        "--specification", metavar="NAME", help="what to break; needed where there are several"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the search (default 0)")
    add_search_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    """Search, tell and store what was found; 1 where it was a failure, 0 where there was none."""
    from avrare.api import load
    from avrare.cli.doubts import warn
    from avrare.failures.failure import record
    from avrare.failures.falsify import BUDGET, falsify
    from avrare.failures.report import falsified_lines

    if args.seed < 0:
        raise UsageError(f"--seed must be at least 0, not {args.seed}")
    scenario = load(args.scenario, args.set)
    warn(scenario.definition.warnings)
    name = _specification(args, scenario)
    problem = scenario.problem(name)
    with progress() as told:
        found = falsify(problem, args.seed, BUDGET if args.budget is None else args.budget, told)
    print(f"{scenario.name}: {name}")
    for line in falsified_lines(scenario, found):
        print(line)
    if found.noise is not None:
        keep(args, record(scenario, name, found.noise))
    return int(ExitCode.PASS if found.noise is None else ExitCode.FAIL)


def _specification(args: argparse.Namespace, scenario: Any) -> str:
    names = scenario.specifications
    if args.specification is None and len(names) > 1:
        raise UsageError("what is to be broken?", f"choose it with --specification: {', '.join(names)}")
    return args.specification or names[0]  # type: ignore[no-any-return]
