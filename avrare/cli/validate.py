"""``avrare validate``: check scenario files; static unless ``--build`` is given; or print their schema."""

from __future__ import annotations

import argparse
import json

from avrare.analysis.check.validation import validate
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.output import print_warnings, say
from avrare.plugin.registry import default_registry
from avrare.scenario.json_schema import scenario_schema


def execute(args: argparse.Namespace) -> int:
    """Check every scenario and print a line for each; return the smallest non-zero exit code."""
    if args.schema and args.scenarios:
        raise UsageError("--schema takes no SCENARIO", "validate the scenarios by a command of their own")
    if args.schema:
        print(json.dumps(scenario_schema(default_registry()), indent=2))
        return int(ExitCode.PASS)
    if not args.scenarios:
        raise UsageError("avrare validate: SCENARIO is required", "avrare validate SCENARIO, or --schema")
    codes = [_validate(path, args) for path in args.scenarios]
    failed = [code for code in codes if code != ExitCode.PASS]
    return min(failed, default=int(ExitCode.PASS))


def _validate(path: str, args: argparse.Namespace) -> int:
    validation = validate(path, args.set, estimator=args.estimator, build=args.build)
    print_warnings(validation.warnings)
    say(*validation.lines(), error=not validation.valid)
    return int(validation.exit_code)
