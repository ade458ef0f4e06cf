"""Progress, texts and storage of failures that ``falsify``, ``replay`` and ``failures`` share."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from avrare.analysis.failures import FAILURES_FOLDER
from avrare.analysis.failures.failure import Failure
from avrare.analysis.failures.shrink import ShrinkResult
from avrare.analysis.failures.storage import FailureDatabase, encode
from avrare.cli.output import print_notes, write_file
from avrare.rollout.noise_words import describe_tape
from avrare.rollout.problem import Problem


@contextmanager
def progress_line(args: argparse.Namespace) -> Iterator[Callable[[str, int], None] | None]:
    """Give a function that redraws a line with the number of rollouts; None where nothing is redrawn."""
    if args.quiet or args.plain or not sys.stderr.isatty():
        yield None
        return

    def draw(activity: str, rollouts: int) -> None:
        print(f"\r\x1b[K{activity}: {rollouts} rollouts", end="", file=sys.stderr, flush=True)

    try:
        yield draw
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def store_failure(args: argparse.Namespace, failure: Failure) -> None:
    """Store a failure and print the commands that replay it."""
    FailureDatabase(Path(args.failures)).add(failure)
    folder = [] if args.failures == FAILURES_FOLDER else ["--failures", args.failures]
    scenario = args.scenario or f"{args.run}/scenario.yaml"
    settings = [word for setting in args.set for word in ("--set", setting)]
    command = ["avrare", "replay", scenario, *settings]
    print_notes(args, f"stored as {failure.id}; {shlex.join([*command, '--failure', failure.id, *folder])}")
    blob = encode(failure)
    if args.write_blob is not None:
        write_file(args.write_blob, blob + "\n", "choose another --write-blob")
        elsewhere = shlex.join([*command, "--blob", "@" + args.write_blob])
    elif len(blob) <= 1000:  # a longer one would fill the terminal
        elsewhere = shlex.join([*command, "--blob", blob])
    else:
        export = shlex.join(["avrare", "failures", "blob", failure.id, *folder])
        elsewhere = f"{export} > FILE, then {shlex.join([*command, '--blob'])} @FILE"
    print_notes(args, f"on another machine: {elsewhere}")


def describe_shrinking(problem: Problem, shrunk: ShrinkResult) -> list[str]:
    """Describe the rest of a failure in numbers and words."""
    if shrunk.after == 0.0:
        description = describe_tape(problem, shrunk.noise)
        lines = [f"it fails without any noise ({shrunk.rollouts} rollouts): {description}"]
        if shrunk.passing_noise is not None:
            lines.append(f"it passes with: {describe_tape(problem, shrunk.passing_noise)}")
        return lines
    lines = [
        f"shrunk to {shrunk.ratio:.1%} of its norm ({shrunk.before:.3g} -> {shrunk.after:.3g}), "
        f"{shrunk.nonzero} of {shrunk.noise.size} numbers ({shrunk.rollouts} rollouts)",
        f"it needs only: {describe_tape(problem, shrunk.noise)}",
    ]
    return lines if shrunk.reason is None else [*lines, f"more than a tenth is left: {shrunk.reason}"]
