"""``avrare confirm``: a pack's estimates again with other random numbers, and whether they agree."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from avrare.base.errors import ExitCode
from avrare.base.number_format import format_estimate
from avrare.cli.options import DISPLAY, REPEATABLE, RUN, SAFE, SEED, WORKERS, Options, add_rows, display
from avrare.cli.output import say, write_files
from avrare.output.terminal.progress_line import Progress
from avrare.rollout.problem import Problem
from avrare.scenario.safe_mode import safe_mode
from avrare_evidence.confirm import Confirmation, confirm
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
_CODES = {"agree": ExitCode.PASS, "disagree": ExitCode.FAIL, "not decided": ExitCode.INCONCLUSIVE}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rows(parser, _OPTIONS)


def execute(args: argparse.Namespace) -> int:
    """Confirm and write the sheet; exit code 1 where the estimates disagree, 3 where nothing is decided."""

    @contextmanager
    def watch(label: str, problem: Problem) -> Iterator[Progress]:
        with Progress(label, problem, "quiet" if args.json else display(args)) as progress:
            yield progress

    options = {"budget": args.budget, "vary": args.vary, "workers": args.workers}
    with safe_mode(args.safe):
        seed = 1 if args.seed is None else args.seed
        confirmation = confirm(args.folder, seed, **options, accept_changes=args.accept_changes, watch=watch)
    folder = Path(args.out or args.folder)
    write_files(folder, {CONFIRMATION: dump_yaml(confirmation.to_dict())})
    if args.json:
        print(json.dumps(confirmation.to_dict()))
    else:
        say(*([] if args.quiet else _describe(confirmation, folder / CONFIRMATION)), confirmation.outcome)
    return int(_CODES[confirmation.outcome])


def _describe(confirmation: Confirmation, sheet: Path) -> Iterator[str]:
    for x in confirmation.comparisons:
        sides = [format_estimate(side.value, (side.low, side.high)) for side in (x.pack, x.fresh)]
        numbers = f"p = {x.p_value:.2g}, power {x.power:.2f}"
        yield f"{x.scenario} {x.rule}: {sides[0]} in the pack, {sides[1]} here; {numbers}"
    for row in confirmation.variations:
        estimate, verdict = format_estimate(row["value"], row["interval"]), row["verdict"] or "no bound"
        yield f"{row['scenario']} {row['rule']} with {', '.join(row['set'])}: {estimate}, {verdict}"
    yield f"sheet to sign: {sheet}"
