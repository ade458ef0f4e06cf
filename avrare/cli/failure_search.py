"""Options, progress line and storage of failures that ``falsify``, ``replay`` and ``failures`` share."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from avrare.cli.output import write_errors
from avrare.cli.parser import at_least

DEFAULT_FOLDER = ".avrare/failures"


def add_failures_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--failures DIR``."""
    text = f"folder of stored failures (default {DEFAULT_FOLDER})"
    parser.add_argument("--failures", default=DEFAULT_FOLDER, metavar="DIR", help=text)


def add_search_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--failures DIR --budget N --write-blob FILE``."""
    add_failures_argument(parser)
    parser.add_argument("--budget", type=at_least(2), metavar="N", help="maximal number of rollouts")
    parser.add_argument("--write-blob", metavar="FILE", help="write the failure as text that --blob reads")


@contextmanager
def progress_line() -> Iterator[Callable[[str, int], None] | None]:
    """Give a function that redraws a line with the number of rollouts; None if stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return

    def draw(activity: str, rollouts: int) -> None:
        print(f"\r\x1b[K{activity}: {rollouts} rollouts", end="", file=sys.stderr, flush=True)

    try:
        yield draw
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def store_failure(args: argparse.Namespace, failure: Any) -> None:
    """Store a failure and print the commands that replay it.

    Raises:
        UsageError: It cannot be written.
    """
    from avrare.analysis.failures.storage import FailureDatabase, encode
    from avrare.base.files import write_text
    from avrare.report.terminal.failure_text import MAX_BLOB

    FailureDatabase(Path(args.failures)).add(failure)
    folder = [] if args.failures == DEFAULT_FOLDER else ["--failures", args.failures]
    scenario = getattr(args, "scenario", None) or f"{args.run}/scenario.yaml"
    settings = [word for setting in args.set for word in ("--set", setting)]
    command = ["avrare", "replay", scenario, *settings]
    print(f"stored as {failure.id}; {shlex.join([*command, '--failure', failure.id, *folder])}")
    blob = encode(failure)
    if args.write_blob is not None:
        with write_errors(args.write_blob, "choose another --write-blob"):
            write_text(Path(args.write_blob), blob + "\n")
        elsewhere = shlex.join([*command, "--blob", "@" + args.write_blob])
    elif len(blob) <= MAX_BLOB:
        elsewhere = shlex.join([*command, "--blob", blob])
    else:
        export = shlex.join(["avrare", "failures", "blob", failure.id, *folder])
        elsewhere = f"{export} > FILE, then {shlex.join([*command, '--blob'])} @FILE"
    print(f"on another machine: {elsewhere}")
