"""``avrare compare SCENARIO --against OTHER``: two versions of a stack on the same noise."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.cli.parser import display
from avrare.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from avrare.compare.paired import Paired

DEFAULT_ROLLOUTS = 1000
_WIDTH = 120
"""Columns that the table needs; a narrower terminal breaks its lines."""
_ONLY_FOR_ESTIMATORS = ("estimators", "truth", "repeat")


def execute(args: argparse.Namespace) -> int:
    """Drive both, show the difference of every specification."""
    from avrare.record.whole import ready
    from avrare.report.paired import document

    _check(args)
    if args.out:
        ready(Path(args.out), "--out")
    paired = _paired(args)
    content = document(paired)
    if args.out:
        _write(Path(args.out), content)
    if args.json:
        print(json.dumps(content))
    else:
        _show(paired, args)
    return int(ExitCode.ROLLOUT_ERRORS if paired.troubled else ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    for option in _ONLY_FOR_ESTIMATORS:
        if getattr(args, option) is not None:
            raise UsageError(
                f"--{option} and --against exclude each other", "--against is Monte Carlo on both"
            )
    if args.workers < 1:
        raise UsageError(f"--workers must be at least 1, not {args.workers}")
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed must be at least 0, not {args.seed}")


def _paired(args: argparse.Namespace) -> Paired:
    from avrare.build.scenario import BuildableScenario
    from avrare.compare.paired import Paired, compare_pairs
    from avrare.execute.processes import ProcessExecutor
    from avrare.execute.serial import SerialExecutor
    from avrare.report.console import Progress
    from avrare.scenario.load import load

    both, second_only = _settings(args.set)
    definitions = (load(args.scenario, both), load(args.against, [*both, *second_only]))
    problems = []
    for definition in definitions:
        wanted = args.specification or definition.estimated
        problems.append(BuildableScenario(definition).problem(wanted))
    seed = definitions[0].seed if args.seed is None else args.seed
    executor = SerialExecutor() if args.workers == 1 else ProcessExecutor(args.workers)
    rollouts = _rollouts(args.budget, problems[0].steps)
    with Progress("", problems[0], display(args)) as progress:

        def watch(number: int) -> Progress:
            progress.label = f"{(args.scenario, args.against)[number]}  {number + 1} of 2"
            progress.began = time.monotonic()
            return progress

        pairs = compare_pairs(problems[0], problems[1], rollouts, seed, executor, watch)
    return Paired((args.scenario, args.against), definitions, tuple(pairs), rollouts, seed)


def _settings(given: Sequence[str]) -> tuple[list[str], list[str]]:
    """The settings of both scenarios and those of the second alone."""
    both: list[str] = []
    second_only: list[str] = []
    for text in given:
        prefix, _, rest = text.partition(".")
        if prefix not in ("scenario", "against") or not rest:
            raise UsageError(
                f"--set {text}: with --against, settings are of a scenario",
                "write --set scenario.KEY=VALUE for both, --set against.KEY=VALUE for the second alone",
            )
        (both if prefix == "scenario" else second_only).append(rest)
    return both, second_only


def _rollouts(text: str | None, steps: int) -> int:
    """Of each version."""
    from avrare.estimation.budget import Budget

    if text is None:
        return DEFAULT_ROLLOUTS
    budget = Budget.parse(text)
    assert budget is not None
    if budget.kind == "seconds":
        raise UsageError("--budget seconds=N does not fit --against", "give rollouts=N or steps=N")
    many = int(budget.amount // (max(steps, 1) if budget.kind == "steps" else 1))
    if many < 1:
        raise UsageError(f"--budget {text} does not pay for one rollout of {steps} steps")
    return many


def _write(folder: Path, content: dict[str, Any]) -> None:
    from avrare.record.whole import write_text

    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "paired.json", json.dumps(content, indent=2) + "\n")
    except OSError as error:
        text = f"{folder}: cannot write: {error.strerror or error}"
        raise UsageError(text, "choose another --out") from error


def _show(paired: Paired, args: argparse.Namespace) -> None:
    from avrare.report.console import screen
    from avrare.report.paired import brief, headline, notes, table

    console = screen(display(args))
    if args.quiet:
        for line in brief(paired):
            console.print(line, markup=False)
        return
    console.width = max(console.width, _WIDTH)
    console.print(headline(paired), style="bold", markup=False)
    console.print()
    console.print(table(paired))
    for line in notes(paired):
        console.print(line, style="yellow", markup=False)
    if args.out:
        console.print("written: paired.json", markup=False)
