"""``avrare failures``: list, add, print and cluster stored failures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.analysis.failures.clusters import cluster
from avrare.analysis.failures.noise_description import describe
from avrare.analysis.failures.shrink import shrink
from avrare.analysis.failures.storage import FailureDatabase, encode
from avrare.analysis.failures.stored_replays import replay_failures, store_worst
from avrare.base.errors import UsageError
from avrare.cli.failure_output import progress_line
from avrare.cli.output import print_warnings, say
from avrare.report.terminal.failure_text import describe_clusters
from avrare.results.reader import find_changes, load_run_scenario, read_failures
from avrare.rollout.loaded_scenario import load


def execute(args: argparse.Namespace) -> None:
    """Run the chosen action and print its lines."""
    actions = {"list": _list, "blob": _blob, "add": _add, "cluster": _cluster}
    for line in actions[args.action](args, FailureDatabase(Path(args.failures))):
        say(line)


def _list(args: argparse.Namespace, database: Any) -> Sequence[str]:
    failures, complaints = database.load_all()
    if not failures and not complaints:
        return [f"{database.folder}: no stored failures"]
    lines = [
        f"{one.id}  {one.scenario}  {one.specification}  robustness {one.robustness:.3g}  norm {one.norm:.3g}"
        for one in failures
    ]
    return [*complaints, *lines]


def _blob(args: argparse.Namespace, database: Any) -> Sequence[str]:
    return [encode(database.load(args.id))]


def _add(args: argparse.Namespace, database: Any) -> Sequence[str]:
    folder = Path(args.run)
    print_warnings((line, None) for line in find_changes(folder))
    new, complaints = store_worst(database, load_run_scenario(folder), read_failures(folder))
    summary = f"{len(new)} new failures in {database.folder}: {', '.join(new)}" if new else "no new failures"
    return [summary, *complaints]


def _cluster(args: argparse.Namespace, database: Any) -> Sequence[str]:
    scenario = load(args.scenario, args.set)
    stored, complaints = database.load_all(scenario.name)
    wanted = [one for one in stored if args.specification in (None, one.specification)]
    if not wanted:
        hint = f"`avrare run {args.scenario} --failures {database.folder}` stores what it finds"
        name = ": ".join(filter(None, (scenario.name, args.specification)))
        raise UsageError(f"{database.folder}: no failure of {name} is stored", hint)
    failures = [one.failure for one in replay_failures(scenario, wanted) if one.outcome == "still fails"]
    if not failures:
        text = f"none of its {len(wanted)} failures fails on {args.scenario} now"
        raise UsageError(f"{database.folder}: {text}")
    tapes = [_shrunk(args, scenario, one) if args.shrink else one.noise for one in failures]
    found = cluster(tapes)
    small = [tapes[k] if args.shrink else _shrunk(args, scenario, failures[k]) for k in found.medoids]
    words = [describe(scenario, tape) for tape in small]
    return [*complaints, *describe_clusters(scenario, failures, found, words)]


def _shrunk(args: argparse.Namespace, scenario: Any, failure: Any) -> Any:
    if args.budget < 2:
        return failure.noise
    with progress_line() as progress:
        return shrink(scenario.problem(failure.specification), failure.noise, args.budget, progress).noise
