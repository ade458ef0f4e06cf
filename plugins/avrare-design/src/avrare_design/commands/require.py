"""``avrare require``: the value of a parameter that keeps a probability below a bound."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import (
    RESUMABLE,
    SCENARIO,
    SEED,
    SET,
    WORKERS,
    Options,
    add_rows,
    display,
    permit_negative_lists,
    read_rollouts,
)
from avrare.cli.output import show_or_write
from avrare.output.terminal.progress_line import Progress
from avrare.rollout.problem import Problem
from avrare_design.require import require

_OPTIONS: Options = {
    **SCENARIO,
    **SET,
    "--parameter KEY": "parameter to search, for example perception.miss_scale",
    "--probability BOUND": "bound to keep, for example '< 1e-4'",
    "--specification NAME": "specification; required if there are several",
    "--between LOW,HIGH": "values to look between (default: a fifth and five times the scenario's)",
    "--budget KIND=N": (
        "budget of all estimates together, as rollouts=N (default 20000)",
        {"type": read_rollouts, "default": 20_000},
    ),
    **SEED,
    **WORKERS,
    **RESUMABLE,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_rows(parser, _OPTIONS)
    permit_negative_lists(parser)


def execute(args: argparse.Namespace) -> int:
    """Search, print the answer and write it; exit code 3 where no value is shown to keep the bound."""
    if args.parameter is None or args.probability is None:
        raise UsageError(
            "--parameter and --probability are required",
            "for example --parameter perception.miss_scale --probability '< 1e-3'",
        )

    @contextmanager
    def show(label: str, problem: Problem) -> Iterator[Progress]:
        with Progress(label, problem, "quiet" if args.json else display(args)) as progress:
            yield progress

    requirement = require(
        args.scenario,
        args.parameter,
        args.probability,
        args.specification,
        between=_read_ends(args.between),
        overrides=args.set,
        rollouts=args.budget,
        seed=args.seed,
        workers=args.workers,
        out=args.out,
        resume=args.resume,
        show=show,
    )
    content = {
        "parameter": requirement.parameter,
        "specification": requirement.specification,
        "limit": requirement.limit,
        "kept": requirement.kept,
        "broken": requirement.broken,
        "root": requirement.root,
        "confidence": requirement.confidence,
        "rising": requirement.rising,
        "trials": list(requirement.table()),
        "warnings": list(requirement.warnings),
    }
    show_or_write(args, "require.json", content, [requirement])
    return int(ExitCode.PASS if requirement.kept is not None else ExitCode.INCONCLUSIVE)


def _read_ends(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError:
        raise UsageError(f"--between {text}: should be LOW,HIGH", "for example --between 0.1,10") from None
    return low, high
