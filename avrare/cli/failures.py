"""``avrare failures``: list, add and print stored failures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from avrare.analysis.failures.storage import FailureDatabase, encode
from avrare.analysis.failures.stored_replays import store_worst
from avrare.cli.output import print_warnings, say
from avrare.results.run import Run


def execute(args: argparse.Namespace) -> None:
    """Run the chosen action and print its lines."""
    actions = {"list": _list, "blob": _blob, "add": _add}
    for line in actions[args.action](args, FailureDatabase(Path(args.failures))):
        say(line)


def _list(args: argparse.Namespace, database: FailureDatabase) -> Sequence[str]:
    failures, complaints = database.load_all()
    if not failures and not complaints:
        return [f"{database.folder}: no stored failures"]
    lines = [
        f"{failure.id}  {failure.scenario}  {failure.specification}  "
        f"robustness {failure.robustness:.3g}  norm {failure.norm:.3g}"
        for failure in failures
    ]
    return [*complaints, *lines]


def _blob(args: argparse.Namespace, database: FailureDatabase) -> Sequence[str]:
    return [encode(database.load(args.id))]


def _add(args: argparse.Namespace, database: FailureDatabase) -> Sequence[str]:
    run = Run.read(args.run)
    print_warnings((line, None) for line in run.changes)
    failures = {name: run[name].failures for name in run if len(run[name].failures.robustness)}
    new, complaints = store_worst(database, run.scenario, failures)
    summary = f"{len(new)} new failures in {database.folder}: {', '.join(new)}" if new else "no new failures"
    return [summary, *complaints]
