"""What the commands that search for failures share: options, a progress line, and where a failure goes."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from avrare.errors import UsageError

FAILURES = ".avrare/failures"


def add_search_arguments(parser: argparse.ArgumentParser) -> None:
    """``--failures DIR --budget ROLLOUTS --write-blob FILE``."""
    parser.add_argument(
        "--failures", default=FAILURES, metavar="DIR", help=f"folder of stored failures; default {FAILURES}"
    )
    parser.add_argument("--budget", type=_rollouts, metavar="N", help="rollouts of a search at most")
    parser.add_argument(
        "--write-blob", metavar="FILE", help="write the failure (of a search: the one found) as a blob"
    )


def _rollouts(text: str) -> int:
    number = int(text) if text.isdecimal() else 0
    if number < 2:
        raise argparse.ArgumentTypeError(f"should be a number of rollouts of at least 2, not {text!r}")
    return number


@contextmanager
def progress() -> Iterator[Callable[[str, int], None] | None]:
    """A line that is written over and over, where stderr is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return

    def tell(doing: str, rollouts: int) -> None:
        print(f"\r\x1b[K{doing}: {rollouts} rollouts", end="", file=sys.stderr, flush=True)

    try:
        yield tell
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def keep(args: argparse.Namespace, failure: Any) -> None:
    """Store a failure and say how to drive it again.

    Raises:
        UsageError: It cannot be written.
    """
    from avrare.failures.database import Database
    from avrare.failures.pack import encode
    from avrare.failures.report import SHORT
    from avrare.record.whole import write_text

    Database(Path(args.failures)).add(failure)
    folder = [] if args.failures == FAILURES else ["--failures", args.failures]
    scenario = getattr(args, "scenario", None) or f"{args.run}/scenario.yaml"
    settings = [word for setting in args.set for word in ("--set", setting)]
    command = ["avrare", "replay", scenario, *settings]
    print(f"stored as {failure.id}; {shlex.join([*command, '--failure', failure.id, *folder])}")
    blob = encode(failure)
    if args.write_blob is not None:
        try:
            write_text(Path(args.write_blob), blob + "\n")
        except OSError as error:
            text = f"{args.write_blob}: cannot write: {error.strerror or error}"
            raise UsageError(text, "choose another --write-blob") from error
        print(f"elsewhere: {shlex.join([*command, '--blob', '@' + args.write_blob])}")
    elif len(blob) <= SHORT:
        print(f"elsewhere: {shlex.join([*command, '--blob', blob])}")
    else:
        words = shlex.join(["avrare", "failures", "blob", failure.id, *folder])
        print(f"elsewhere: {words} > FILE, then {shlex.join([*command, '--blob'])} @FILE")
