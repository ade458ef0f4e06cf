"""``avrare failures``: list, add, print and cluster stored failures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.failure_search import add_failures_argument, progress_line
from avrare.cli.parser import add_set_argument, at_least

_MEDOID_BUDGET = 400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's actions and options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list all failures, one per line")
    blob = actions.add_parser("blob", help="print one failure as text for `avrare replay --blob`")
    blob.add_argument("id", metavar="ID")
    add = actions.add_parser("add", help="store the failures of a run")
    add.add_argument("run", metavar="DIR", help="folder written by `avrare run`")
    cluster = actions.add_parser("cluster", help="cluster the failures of a scenario")
    cluster.add_argument("scenario", metavar="SCENARIO", help="scenario file")
    add_set_argument(cluster)
    cluster.add_argument("--specification", metavar="NAME", help="only failures of this specification")
    cluster.add_argument("--shrink", action="store_true", help="shrink all failures before clustering (slow)")
    text = f"rollouts for shrinking one failure (default {_MEDOID_BUDGET}); 0: do not shrink"
    cluster.add_argument("--budget", type=at_least(0), default=_MEDOID_BUDGET, metavar="N", help=text)
    for action in (listing, blob, add, cluster):
        add_failures_argument(action)


def execute(args: argparse.Namespace) -> int:
    """Run the chosen action and print its lines."""
    from avrare.analysis.failures.storage import FailureDatabase

    actions = {"list": _list, "blob": _blob, "add": _add, "cluster": _cluster}
    for line in actions[args.action](args, FailureDatabase(Path(args.failures))):
        print(line)
    return int(ExitCode.PASS)


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
    from avrare.analysis.failures.storage import encode

    return [encode(database.load(args.id))]


def _add(args: argparse.Namespace, database: Any) -> Sequence[str]:
    from avrare.analysis.failures.stored_replays import store_worst
    from avrare.results.reader import load_run_scenario
    from avrare.results.stored_rollouts import read_failures

    folder = Path(args.run)
    new, complaints = store_worst(database, load_run_scenario(folder), read_failures(folder))
    summary = f"{len(new)} new failures in {database.folder}: {', '.join(new)}" if new else "no new failures"
    return [summary, *complaints]


def _cluster(args: argparse.Namespace, database: Any) -> Sequence[str]:
    from avrare.analysis.failures.clusters import cluster
    from avrare.analysis.failures.describe import describe
    from avrare.analysis.failures.stored_replays import replay_failures
    from avrare.report.terminal.failure_text import describe_clusters
    from avrare.rollout.loaded_scenario import load

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
    from avrare.analysis.failures.shrink import shrink

    if args.budget < 2:
        return failure.noise
    with progress_line() as progress:
        return shrink(scenario.problem(failure.specification), failure.noise, args.budget, progress).noise
