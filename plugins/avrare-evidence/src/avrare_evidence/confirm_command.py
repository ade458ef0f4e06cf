"""``avrare confirm``: a pack's estimates again with other random numbers, and whether they agree."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from avrare.base.errors import ExitCode
from avrare.cli.options import DISPLAY, REPEATABLE, RUN, SAFE, SEED, WORKERS, Options, add_rows, display
from avrare.cli.output import print_notes, show, write_files
from avrare.output.terminal.progress_line import Progress
from avrare_evidence.confirm import confirm
from avrare_evidence.pack import CONFIRMATION, dump_yaml

_OPTIONS: Options = {
    "folder DIR": "pack that avrare evidence has written",
    **SEED,
    **WORKERS,
    "--budget KIND=N": RUN["--budget KIND=N"],
    "--vary KEY=LAW": (
        "judge the bounds once more with another value or law of a scene parameter; may be repeated",
        REPEATABLE,
    ),
    "--accept-changes": "go on where versions differ from the pack's; the sheet names them",
    "--out DIR": "write confirmation.yaml into this folder (default: the pack)",
    **SAFE,
    **DISPLAY,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rows(parser, _OPTIONS)


def execute(args: argparse.Namespace) -> int:
    """Confirm and write the sheet; exit code 1 where the estimates disagree, 3 where nothing is decided."""
    watch = partial(Progress, mode="quiet" if args.json else display(args))
    options = {"budget": args.budget, "vary": args.vary, "workers": args.workers}
    seed = 1 if args.seed is None else args.seed
    confirmation = confirm(args.folder, seed, **options, accept_changes=args.accept_changes, watch=watch)
    folder, content = Path(args.out or args.folder), confirmation.to_dict()
    write_files(folder, {CONFIRMATION: dump_yaml(content)})
    show(args, content, [confirmation])
    print_notes(args, f"sheet to sign: {folder / CONFIRMATION}")
    codes = {"agree": ExitCode.PASS, "disagree": ExitCode.FAIL, "not decided": ExitCode.INCONCLUSIVE}
    return int(codes[confirmation.outcome])
