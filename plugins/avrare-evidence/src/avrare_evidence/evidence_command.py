"""``avrare evidence``: results as a safety case that an assessor can check."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import DISPLAY, SAFE, Options, add_rows
from avrare.cli.output import print_notes, say
from avrare_evidence.argument import STATES
from avrare_evidence.pack import PAGE, Pack, write_pack

_OPTIONS: Options = {
    "folders DIR": ("folder of avrare run, check or rate; with --check: a pack", {"nargs": "+"}),
    "--out DIR": "folder of the pack",
    "--check": "check a pack: every file by its digest, references, and the rules of the notation",
    **SAFE,
    **DISPLAY,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rows(parser, _OPTIONS)


def execute(args: argparse.Namespace) -> int:
    """Write a pack, or check one: exit code 1 where something in it has changed."""
    if args.check:
        return _check(args)
    if args.out is None:
        raise UsageError("--out is required", "name the folder of the pack: --out pack")
    case = write_pack(args.folders, args.out).case
    states = {goal.text: STATES[goal.measure.verdict] for goal in case.values() if goal.measure is not None}
    if args.json:
        print(json.dumps({"folder": args.out, "claims": states}))
    else:
        say(*(f"{text}: {state}" for text, state in states.items()))
        print_notes(args, f"the page to read: {Path(args.out) / PAGE}")
    return int(ExitCode.PASS)


def _check(args: argparse.Namespace) -> int:
    if len(args.folders) != 1 or args.out is not None:
        raise UsageError("--check takes one pack, and no --out", "avrare evidence --check pack")
    pack = Pack.read(args.folders[0])
    faults, changes = pack.find_faults(), pack.find_version_changes()
    if args.json:
        print(json.dumps({"faults": faults, "version_changes": changes}))
    else:
        count = len(pack.manifest.files)
        say(*faults, *(f"note: {line}" for line in changes))
        say(f"faults: {len(faults)}" if faults else f"{count} files and the argument are as written")
    return int(ExitCode.FAIL if faults else ExitCode.PASS)
