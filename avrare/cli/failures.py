"""``avrare failures``: list stored failures, hand them on, describe and sort them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.cli.searching import FAILURES, progress
from avrare.errors import ExitCode, UsageError

_MEDOID_BUDGET = 400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Actions of ``avrare failures``."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="all of them, one a line")
    blob = actions.add_parser("blob", help="print one as text that `avrare replay --blob` takes")
    blob.add_argument("id", metavar="ID")
    add = actions.add_parser("add", help="store the failures of a run")
    add.add_argument("run", metavar="DIR", help="folder that `avrare run` has written")
    cluster = actions.add_parser("cluster", help="sort those of a scenario into kinds")
    cluster.add_argument("scenario", metavar="SCENARIO", help="scenario file")
    cluster.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one value")
    cluster.add_argument("--specification", metavar="NAME", help="whose failures; default: those of all")
    cluster.add_argument("--shrink", action="store_true", help="shrink all before they are sorted: slow")
    what = f"rollouts for shrinking one failure (default {_MEDOID_BUDGET}); 0: describe it as it is"
    cluster.add_argument("--budget", type=int, default=_MEDOID_BUDGET, metavar="N", help=what)
    for action in (listing, blob, add, cluster):
        action.add_argument(
            "--failures", default=FAILURES, metavar="DIR", help=f"where they are stored; default {FAILURES}"
        )


def execute(args: argparse.Namespace) -> int:
    """Do what was asked for."""
    from avrare.failures.database import Database

    actions = {"list": _list, "blob": _blob, "add": _add, "cluster": _cluster}
    for line in actions[args.action](args, Database(Path(args.failures))):
        print(line)
    return int(ExitCode.PASS)


def _list(args: argparse.Namespace, database: Any) -> Sequence[str]:
    failures, complaints = database.all()
    if not failures and not complaints:
        return [f"{database.folder}: no failure is stored"]
    lines = [
        f"{one.id}  {one.scenario}  {one.specification}  robustness {one.robustness:.3g}  norm {one.norm:.3g}"
        for one in failures
    ]
    return [*complaints, *lines]


def _blob(args: argparse.Namespace, database: Any) -> Sequence[str]:
    from avrare.failures.pack import encode

    return [encode(database.load(args.id))]


def _add(args: argparse.Namespace, database: Any) -> Sequence[str]:
    from avrare.api import load
    from avrare.failures.known import remember
    from avrare.record.failures import read_failures

    folder = Path(args.run)
    if not (folder / "scenario.yaml").is_file():
        raise UsageError(f"{folder}: no scenario.yaml in it", "give the folder that `avrare run` has written")
    new, complaints = remember(database, load(folder / "scenario.yaml"), read_failures(folder))
    told = f"{len(new)} new failures in {database.folder}: {', '.join(new)}" if new else "nothing new"
    return [told, *complaints]


def _cluster(args: argparse.Namespace, database: Any) -> Sequence[str]:
    from avrare.api import load
    from avrare.failures.clusters import cluster
    from avrare.failures.known import rerun
    from avrare.failures.report import cluster_lines
    from avrare.failures.words import describe

    if args.budget < 0:
        raise UsageError(f"--budget must be at least 0, not {args.budget}")
    scenario = load(args.scenario, args.set)
    stored, complaints = database.all(scenario.name)
    wanted = [one for one in stored if args.specification in (None, one.specification)]
    if not wanted:
        hint = f"`avrare run {args.scenario} --failures {database.folder}` stores what it finds"
        raise UsageError(f"{database.folder}: no failure of {_of(args, scenario)} is stored", hint)
    failures = [one.failure for one in rerun(scenario, wanted) if one.outcome == "still fails"]
    if not failures:
        raise UsageError(
            f"{database.folder}: none of its {len(wanted)} failures fails on {args.scenario} now"
        )
    tapes = [_small(args, scenario, one) if args.shrink else one.noise for one in failures]
    found = cluster(tapes)
    small = [tapes[k] if args.shrink else _small(args, scenario, failures[k]) for k in found.medoids]
    words = [describe(scenario, tape) for tape in small]
    return [*complaints, *cluster_lines(scenario, failures, found, words)]


def _of(args: argparse.Namespace, scenario: Any) -> str:
    return str(scenario.name if args.specification is None else f"{scenario.name}: {args.specification}")


def _small(args: argparse.Namespace, scenario: Any, failure: Any) -> Any:
    from avrare.failures.shrink import shrink

    if args.budget < 2:
        return failure.noise
    with progress() as told:
        return shrink(scenario.problem(failure.specification), failure.noise, args.budget, told).noise
