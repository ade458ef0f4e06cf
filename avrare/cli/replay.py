"""``avrare replay``: drive a failure again, here and now, and say whether it still is one."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from avrare.cli.searching import add_search_arguments, keep, progress
from avrare.errors import ExitCode, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare replay``."""
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="scenario file; --run has its own")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override one value")
    which = parser.add_argument_group("which failure")
    which.add_argument("--failure", metavar="ID", help="of the stored ones; with --run: its number, from 0")
    which.add_argument(
        "--blob", metavar="TEXT", help="the failure itself; @FILE reads it from a file, @- from stdin"
    )
    which.add_argument("--run", metavar="DIR", help="of a run: the worst failure")
    which.add_argument("--specification", metavar="NAME", help="of --run: whose failure")
    add_search_arguments(parser)
    parser.add_argument("--shrink", action="store_true", help="look for the smallest noise that still fails")
    parser.add_argument("--csv", metavar="FILE", help="write the rollout as a CSV file for `avrare monitor`")
    parser.add_argument(
        "--commonroad", metavar="FILE", help="write it as a CommonRoad scenario; the ego is 1"
    )


def execute(args: argparse.Namespace) -> int:
    """Replay, and with ``--shrink`` shrink; 0 where it fails again, 1 where it does not."""
    from avrare.failures.divergence import replay
    from avrare.failures.failure import kept
    from avrare.failures.report import replayed_lines

    _check(args)
    scenario, failure = _of_run(args) if args.run is not None else _stored(args)
    found = replay(scenario, failure)
    for line in replayed_lines(found):
        print(line)
    _export(args, scenario, found.drive, f"failure {failure.id}")
    if found.drive.outcome == "error":
        return int(ExitCode.ROLLOUT_ERRORS)
    if found.drive.outcome == "passes":
        return int(ExitCode.FAIL)
    if args.shrink:
        _shrink(args, scenario, failure)
    elif args.write_blob is not None:
        keep(args, kept(scenario, failure.specification, failure.noise, found.drive))
    return int(ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    if args.run is None:
        if args.scenario is None:
            raise UsageError("avrare replay: the scenario is missing", "avrare replay SCENARIO --failure ID")
        if (args.failure is None) == (args.blob is None):
            raise UsageError("which failure?", "give one of --failure ID, --blob TEXT and --run DIR")
        if args.specification is not None:
            raise UsageError("--specification is for --run", "a stored failure knows its own")
    elif args.blob is not None:
        raise UsageError("--blob and --run together", "replay one after the other")
    for name in ("csv", "commonroad"):
        if getattr(args, name) == "":
            raise UsageError(f"--{name} should be a file, not ''")


def _stored(args: argparse.Namespace) -> tuple[Any, Any]:
    """Scenario and failure of ``--failure`` or ``--blob``."""
    from avrare.api import load
    from avrare.failures.database import Database
    from avrare.failures.pack import decode

    if args.blob is not None:
        failure = decode(_blob(args.blob))
    else:
        failure = Database(Path(args.failures)).load(args.failure)
    return load(args.scenario, args.set), failure


def _blob(text: str) -> str:
    if not text.startswith("@"):
        return text
    if text == "@-":
        return sys.stdin.read()
    try:
        return Path(text[1:]).read_text(encoding="ascii")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UsageError(f"{text[1:]}: cannot be read: {reason}", "--blob @FILE reads a blob") from None


def _of_run(args: argparse.Namespace) -> tuple[Any, Any]:
    """The scenario of a run, or the one that is named, and the run's failure as it was."""
    from avrare.api import load
    from avrare.failures.failure import of_run
    from avrare.record.failures import chosen_failure, versions

    folder = Path(args.run)
    if not (folder / "scenario.yaml").is_file():
        raise UsageError(f"{folder}: no scenario.yaml in it", "give the folder that `avrare run` has written")
    own = load(folder / "scenario.yaml")
    name, tape, robustness = chosen_failure(folder, args.specification, _number(args.failure))
    stored = of_run(own, name, tape, robustness, versions(folder))
    path = args.scenario or folder / "scenario.yaml"
    return load(path, args.set), stored


def _number(text: str | None) -> int | None:
    if text is not None and not text.isdecimal():
        raise UsageError(f"--failure {text}: the failures of a run have numbers, from 0")
    return None if text is None else int(text)


def _export(args: argparse.Namespace, scenario: Any, found: Any, source: str) -> None:
    if args.csv is None and args.commonroad is None:
        return
    from avrare.failures.export_commonroad import to_commonroad
    from avrare.failures.export_csv import to_csv, vehicle_names
    from avrare.record.trace import Recording

    if not found.signals:
        raise UsageError(f"{source}: it breaks down at the start: there is nothing to write")
    scene = scenario.scene
    names = scene.names if scene is not None else ()
    recording = Recording(source, float(scenario.stack.loop.simulator.dt), 0.0, found.signals, scene, names)
    if args.csv is not None:
        _write(args.csv, to_csv(recording))
        for name, written in zip(names, vehicle_names(names), strict=True):
            if written != name:
                print(f"the vehicle {name!r} is called {written!r} there: {name!r} is the ego")
    if args.commonroad is not None:
        _write(args.commonroad, to_commonroad(recording, scenario.name))


def _write(path: str, text: str) -> None:
    from avrare.record.whole import write_text

    try:
        write_text(Path(path), text)
    except OSError as error:
        raise UsageError(f"{path}: cannot write: {error.strerror or error}", "choose another file") from error
    print(f"written to {path}")


def _shrink(args: argparse.Namespace, scenario: Any, failure: Any) -> None:
    from avrare.failures.failure import record
    from avrare.failures.report import shrunk_lines
    from avrare.failures.shrink import BUDGET, shrink

    budget = BUDGET if args.budget is None else args.budget
    with progress() as told:
        small = shrink(scenario.problem(failure.specification), failure.noise, budget, told)
    for line in shrunk_lines(scenario, small):
        print(line)
    keep(args, record(scenario, failure.specification, small.noise))
