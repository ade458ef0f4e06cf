"""``avrare compare``: estimators side by side, on the same problem with the same budget."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.cli.parser import add_display_arguments, display
from avrare.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from avrare.report.progress import Mode

_EXAMPLE = """\
SCENARIO is a scenario file, or problem:ID: a reference problem with its exact answer
('avrare compare problem:' lists them).

NAMES are estimators with commas between them; variants of one have their options
behind colons: mc,ams,ams:particles=100:discard=10

examples:
  avrare compare problem:d_rw_L3.8 --estimators mc,ams,ce --budget steps=1e6
  avrare compare drive.yaml --specification no_collision --estimators mc,ams \\
      --budget steps=40000 --repeat 5 --truth mc=10000 --workers 4 --out comparison
  avrare compare drive.yaml --against drive_new.yaml --budget rollouts=5000
  avrare compare drive.yaml --against drive.yaml --set against.controller.horizon=15
"""
_REPEAT = 10
_WIDTH = 100
"""Columns that the table needs; a narrower terminal breaks its lines."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("scenario", metavar="SCENARIO", help="scenario file, or problem:ID")
    parser.add_argument(
        "--against",
        metavar="OTHER",
        help="another version of the scenario, on the same noise",
    )
    parser.add_argument("--estimators", metavar="NAMES", help="what to compare, e.g. mc,ams,ce")
    parser.add_argument("--budget", metavar="KIND=N", help="steps=N or rollouts=N, for each estimate")
    parser.add_argument("--repeat", type=int, metavar="R", help=f"repetitions (default {_REPEAT})")
    parser.add_argument("--specification", metavar="NAME", help="of a scenario that has several")
    parser.add_argument("--truth", metavar="P", help="the true probability, or mc=ROLLOUTS to find it first")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="ams.particles=100 for every ams; scenario.steps=20 for the scenario; may be repeated",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="of the first repetition; the scenario's, or 0")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--out", metavar="DIR", help="write comparison.json, .md and .png")
    parser.add_argument(
        "--json", action="store_true", help="print comparison.json and nothing else on stdout"
    )
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")
    add_display_arguments(parser)


def execute(args: argparse.Namespace) -> int:
    """Compare, show and write what was found."""
    from avrare.compare.document import document
    from avrare.record.whole import ready

    if args.scenario == "problem:":
        return _list_problems()
    if args.against is not None:
        from avrare.cli import compare_against

        return compare_against.execute(args)
    args.repeat = _REPEAT if args.repeat is None else args.repeat
    _check(args)
    if args.out:
        ready(Path(args.out), "--out")
    comparison = _compare(args)
    content = document(comparison)
    written = _write(comparison, content, args) if args.out else []
    if args.json:
        print(json.dumps(content))
    else:
        _show(comparison, written, display(args))
    if comparison.interrupted:
        return int(ExitCode.INTERRUPTED)
    health = [name for entry in comparison.entries for one in entry.repetitions for name in one.health]
    return int(ExitCode.ROLLOUT_ERRORS if "errors" in health else ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    for option in ("estimators", "budget"):
        if getattr(args, option) is None:
            example = {"estimators": "mc,ams", "budget": "steps=1e6"}[option]
            raise UsageError(f"--{option} is required", f"for example --{option} {example}")
    for option in ("repeat", "workers"):
        if getattr(args, option) < 1:
            raise UsageError(f"--{option} must be at least 1, not {getattr(args, option)}")
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed must be at least 0, not {args.seed}")


def _compare(args: argparse.Namespace) -> Any:
    from avrare.compare.arms import parse_arms, part_settings
    from avrare.compare.study import Design, compare
    from avrare.compare.truth import parse_truth
    from avrare.plugin.registry import default_registry
    from avrare.report.console import Progress

    budget = _budget(args.budget)
    truth = parse_truth(args.truth) if args.truth is not None else None
    of_scenario, of_estimators = part_settings(args.set)
    case = _case(args, of_scenario, truth)
    arms = parse_arms(args.estimators, of_estimators, case.estimator, default_registry())
    design = Design(budget, args.repeat, case.seed if args.seed is None else args.seed, args.workers)
    with Progress(case.name, case.problem, display(args)) as progress:

        def watch(name: str) -> Any:
            progress.label, progress.began = f"{case.name}  {name}", time.monotonic()
            return progress

        return compare(case, arms, design, watch, truth if isinstance(truth, int) else None)


def _budget(text: str) -> Any:
    from avrare.estimation.budget import Budget

    budget = Budget.parse(text)
    assert budget is not None
    if budget.kind == "seconds":
        raise UsageError(
            "--budget seconds=N cannot be compared: it buys another cost on every machine and each time",
            "give steps=N or rollouts=N",
        )
    return budget


def _case(args: argparse.Namespace, overrides: list[str], truth: Any) -> Any:
    from dataclasses import replace

    from avrare.compare.case import REFERENCE, reference_case, scenario_case
    from avrare.compare.truth import Truth

    if not args.scenario.startswith(REFERENCE):
        case = scenario_case(args.scenario, args.specification, overrides)
        return replace(case, truth=truth) if isinstance(truth, Truth) else case
    case = reference_case(args.scenario.removeprefix(REFERENCE))
    for option, given in (
        ("--truth", truth), ("--specification", args.specification), ("--set scenario.KEY", overrides),
    ):  # fmt: skip
        if given:
            raise UsageError(
                f"{option} does not fit {args.scenario}", "it has one formula and an exact answer"
            )
    return case


def _list_problems() -> int:
    from avrare.testing.problems import reference_problems

    for problem in reference_problems():
        print(f"{problem.id:<26}{problem.probability:<12.4g}{problem.text}")
    return int(ExitCode.PASS)


def _write(comparison: Any, content: dict[str, Any], args: argparse.Namespace) -> list[str]:
    """Names of the files that were written to ``--out``."""
    from avrare.record.whole import write_text
    from avrare.report import comparison_picture, picture
    from avrare.report.comparison import markdown

    folder = Path(args.out)
    files = {
        "comparison.json": json.dumps(content, indent=2) + "\n",
        "comparison.md": markdown(comparison),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_text(folder / name, text)
        if args.no_pictures:
            return list(files)
        if not picture.available():
            print("no picture: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
            return list(files)
        comparison_picture.draw(comparison, folder / "comparison.png")
    except OSError as error:
        text = f"{folder}: cannot write: {error.strerror or error}"
        raise UsageError(text, "choose another --out") from error
    return [*files, "comparison.png"]


def _show(comparison: Any, written: list[str], mode: Mode) -> None:
    from avrare.report.comparison import brief, headline, notes, table
    from avrare.report.console import screen

    console = screen(mode)
    if mode == "quiet":
        for line in brief(comparison):
            console.print(line, markup=False)
        return
    console.width = max(console.width, _WIDTH)
    first, *others = headline(comparison)
    console.print(first, style="bold", markup=False)
    for line in [*others, ""]:
        console.print(line, markup=False)
    console.print(table(comparison))
    for line in notes(comparison):
        console.print(line, style="yellow", markup=False)
    if written:
        console.print(f"written: {', '.join(written)}", markup=False)
