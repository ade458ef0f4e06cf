"""``avrare require``: the value of a parameter that keeps a probability below a bound."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from avrare.analysis.causes.require import require
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import display
from avrare.cli.output import show_or_write
from avrare.cli.sensitivity import read_rollouts
from avrare.output.terminal.progress_line import Progress
from avrare.rollout.problem import Problem

_ROLLOUTS = 20_000


def execute(args: argparse.Namespace) -> int:
    """Search, print the answer and write it; exit code 3 where no value is shown to keep the bound."""
    if args.parameter is None or args.probability is None:
        raise UsageError(
            "--parameter and --probability are required",
            "for example --parameter perception.miss_scale --probability '< 1e-3'",
        )
    args.quiet = args.json

    @contextmanager
    def show(label: str, problem: Problem) -> Iterator[Progress]:
        with Progress(label, problem, display(args)) as progress:
            yield progress

    found = require(
        args.scenario,
        args.parameter,
        args.probability,
        args.specification,
        between=_read_ends(args.between),
        overrides=args.set,
        rollouts=read_rollouts(args.budget, _ROLLOUTS),
        seed=args.seed,
        workers=args.workers,
        out=args.out,
        show=show,
    )
    content = {
        "parameter": found.parameter,
        "specification": found.specification,
        "limit": found.limit,
        "kept": found.kept,
        "broken": found.broken,
        "root": found.root,
        "confidence": found.confidence,
        "rising": found.rising,
        "trials": list(found.table()),
        "warnings": list(found.warnings),
    }
    show_or_write(args, "require.json", content, found.lines())
    return int(ExitCode.PASS if found.kept is not None else ExitCode.INCONCLUSIVE)


def _read_ends(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise UsageError(f"--between {text}: should be LOW,HIGH", "for example --between 0.1,10") from None
    return low, high
