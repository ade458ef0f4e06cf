"""``avrare monitor`` on a folder of recordings, or with every vehicle of a file as the ego."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import display
from avrare.cli.output import say, write_files
from avrare.driving import Road
from avrare.estimation.result.result import finite
from avrare_recordings.batch import monitor_all
from avrare_recordings.output.batch_documents import write_batch_csv
from avrare_recordings.output.batch_table import print_batch

EVERY = "all"
"""Value of ``--ego``: each vehicle in turn."""


def is_batch(args: argparse.Namespace) -> bool:
    """Return whether the arguments ask for several drives: a folder, or every vehicle of a file."""
    path = Path(args.file)
    if not path.is_dir():
        return bool(args.ego == EVERY)
    return (
        args.rule is not None and not (path / "result.json").exists() and not any(path.glob("*/result.json"))
    )


def execute(args: argparse.Namespace, road: Road | None) -> int:
    """Score all drives and print one table; return exit code 1 if any is violated, 4 if none was scored."""
    if args.rule is None:
        raise UsageError("many drives need --rule", "give --rule NAME, or several: --rule R_G1,R_I2")
    result = monitor_all(
        args.file,
        [word.strip() for word in args.rule.split(",") if word.strip()],
        overrides=args.set,
        ego=None if args.ego == EVERY else args.ego,
        scenario=args.scenario,
        road=road,
        network=args.network,
        workers=args.workers,
    )
    if args.out is not None:
        folder = Path(args.out)
        write_files(folder, {"monitor.json": json.dumps(finite(result.to_dict())) + "\n"})
        with explain_file_errors(f"{folder}: cannot write", "choose another --out"):
            write_batch_csv(result, folder / "monitor.csv")
    if args.json:
        print(json.dumps(finite(result.to_dict())))
    elif args.quiet:
        say(*result.lines()[: len(result.totals)])
    else:
        print_batch(result, display(args))
    if not result.scores:
        raise UsageError(f"{args.file}: no drive could be scored", "the reasons are above")
    return int(ExitCode.FAIL if any(score.violations for score in result.scores) else ExitCode.PASS)
