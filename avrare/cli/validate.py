"""``avrare validate``: check scenario files; static unless ``--build`` is given."""

from __future__ import annotations

import argparse
import sys

from avrare.base.errors import AvrareError, ExitCode
from avrare.cli.output import print_warnings
from avrare.scenario.load import load


def execute(args: argparse.Namespace) -> int:
    """Check every scenario and print a line for each; return the smallest non-zero exit code."""
    codes = [_check(path, args) for path in args.scenarios]
    failed = [code for code in codes if code != ExitCode.PASS]
    return min(failed, default=int(ExitCode.PASS))


def _check(path: str, args: argparse.Namespace) -> int:
    try:
        scenario = load(path, args.set, args.estimator)
        print_warnings(scenario.warnings)
        if args.build:
            from avrare.stack.builder import build_and_try

            print_warnings(build_and_try(scenario, steps=3))
    except AvrareError as error:
        print("\n".join(error.lines()), file=sys.stderr)
        return int(error.exit_code)
    steps, count = scenario.steps, len(scenario.specifications)
    parts = [
        scenario.name,
        f"{steps} step{'s' * (steps != 1)}",
        f"{count} specification{'s' * (count != 1)}",
        f"estimator {scenario.estimator.plugin}",
        *(["built and run for 3 steps"] if args.build else []),
    ]
    print(f"{path}: ok  {', '.join(parts)}")
    return int(ExitCode.PASS)
