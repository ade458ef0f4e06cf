"""``avrare validate``: is the scenario right? Static unless ``--build`` asks for more."""

from __future__ import annotations

import argparse
import importlib
import sys

from avrare.cli.doubts import warn
from avrare.cli.parser import add_scenario_arguments
from avrare.errors import AvrareError, ExitCode
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scenario_arguments(parser)
    parser.add_argument("--build", action="store_true", help="also build the stack and run three steps")


def execute(args: argparse.Namespace) -> int:
    """Check every scenario, print one line for each, and exit with the first reason to fail."""
    codes = [_check(path, args) for path in args.scenarios]
    failed = [code for code in codes if code != ExitCode.PASS]
    return min(failed, default=int(ExitCode.PASS))


def _check(path: str, args: argparse.Namespace) -> int:
    try:
        scenario = load(path, args.set, args.estimator)
        warn(scenario.warnings)
        if args.build:
            stack = importlib.import_module("avrare.build.stack")
            warn(stack.build_and_try(scenario, steps=3))
    except AvrareError as error:
        print("\n".join(error.lines()), file=sys.stderr)
        return int(error.exit_code)
    print(f"{path}: ok  {describe(scenario)}" + (", built and run for 3 steps" if args.build else ""))
    return int(ExitCode.PASS)


def describe(scenario: Scenario) -> str:
    """``lane_change, 40 steps, 5 specifications, estimator mc``."""
    many = len(scenario.specifications)
    return (
        f"{scenario.name}, {scenario.steps} step{'s' * (scenario.steps != 1)}, "
        f"{many} specification{'s' * (many != 1)}, estimator {scenario.estimator.plugin}"
    )
