"""``avrare plugins --check``: the checks of a component."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.output import say
from avrare.plugin.registry import default_registry
from avrare.scenario.overrides import override
from avrare.scenario.value_positions import Mark, Node
from avrare.testing.conformance.suite import Outcome, examine, subjects


def check_components(args: argparse.Namespace) -> int:
    """Print one line per check; return exit code 1 if any failed."""
    if not __debug__:
        raise UsageError("the checks are assertions, which python -O disables", "run Python without -O")
    outcomes = []
    for subject in subjects(default_registry(), args.check, _options(args.set), args.kind):
        if not args.json:
            say(f"{subject.kind} {subject.name} ({subject.row.origin})")
        for outcome in examine(subject):
            outcomes.append(outcome)
            if not args.json:
                _print_outcome(outcome)
    statuses = [outcome.status for outcome in outcomes]
    if args.json:
        print(json.dumps([asdict(outcome) for outcome in outcomes], indent=2))
    else:
        say(", ".join(f"{statuses.count(status)} {status}" for status in ("passed", "failed", "skipped")))
    return int(ExitCode.FAIL if "failed" in statuses else ExitCode.PASS)


def _options(settings: list[str]) -> dict[str, object]:
    return dict(override(Node({}, Mark("--set")), settings).plain())


def _print_outcome(outcome: Outcome) -> None:
    say(f"  {outcome.status:<8}{outcome.check:<30}{outcome.sentence}")
    if outcome.reason:
        say(f"{'':10}{outcome.reason}")
    sys.stdout.flush()
