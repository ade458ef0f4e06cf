"""``avrare check-plugin``: does a plugin keep to what avrare relies on?"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict

from avrare.authors.outcome import Outcome
from avrare.authors.suite import examine, subjects
from avrare.errors import ExitCode, UsageError
from avrare.plugin.registry import default_registry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("name", metavar="NAME", help="a component, or a distribution: all of its components")
    parser.add_argument("--kind", help="only components of this kind")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="an option of the component",
    )
    parser.add_argument("--json", action="store_true", help="print a list of objects instead of lines")


def execute(args: argparse.Namespace) -> int:
    """Print one row for each check; exit 1 if any failed."""
    if not __debug__:
        raise UsageError("the checks are assertions, which python -O leaves out", "run it without -O")
    chosen = [
        subject
        for subject in subjects(default_registry(), args.name, _options(args.set))
        if args.kind in (None, subject.kind)
    ]
    if not chosen:
        raise UsageError(f"{args.name!r} has no component of kind {args.kind!r}")
    outcomes = []
    for subject in chosen:
        if not args.json:
            print(f"{subject.kind} {subject.name} ({subject.row.origin})")
        for outcome in examine(subject):
            outcomes.append(outcome)
            if not args.json:
                _show(outcome.status, outcome.check, outcome.sentence, outcome.reason)
    return _report(outcomes, args.json)


def _report(outcomes: list[Outcome], as_json: bool) -> int:
    found = [outcome.status for outcome in outcomes]
    if as_json:
        print(json.dumps([asdict(outcome) for outcome in outcomes], indent=2))
    else:
        print(", ".join(f"{found.count(status)} {status}" for status in ("passed", "failed", "skipped")))
    return int(ExitCode.FAIL if "failed" in found else ExitCode.PASS)


def _options(settings: list[str]) -> dict[str, object]:
    """``KEY=VALUE`` words as options; values are YAML.

    Raises:
        ScenarioError: A word is no setting.
    """
    from avrare.scenario.overrides import override
    from avrare.scenario.source import Mark, Node

    plain = override(Node({}, Mark("--set")), settings).plain()
    return dict(plain)


def _show(status: str, check: str, sentence: str, reason: str) -> None:
    print(f"  {status:<8}{check:<30}{sentence}")
    if reason:
        print(f"{'':10}{reason}")
    sys.stdout.flush()
