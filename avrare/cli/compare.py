"""``avrare compare``: estimators with equal budgets, or two versions of a stack on the same noise."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from avrare.analysis.compare import REPEAT
from avrare.analysis.compare.comparison import Comparison
from avrare.analysis.compare.paired_comparison import PairedComparison, compare_versions
from avrare.analysis.compare.study import StudyWatch, compare
from avrare.base.atomic_files import ensure_writable
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import display
from avrare.cli.output import can_draw, say, write_files
from avrare.output.documents import comparison_document, paired_document
from avrare.output.plots.estimate_plots import plot_comparison
from avrare.output.terminal.comparison_table import comparison_table, markdown, paired_table
from avrare.output.terminal.console import make_console, print_lines, print_table
from avrare.output.terminal.progress_line import Progress
from avrare.rollout.problem import Problem
from avrare.testing.problems import reference_problems


def execute(args: argparse.Namespace) -> int:
    """Compare, print and write the comparison."""
    if args.scenario == "problem:":
        for problem in reference_problems():
            print(f"{problem.id:<26}{problem.probability:<12.4g}{problem.text}")
        return int(ExitCode.PASS)
    _check(args)
    if args.out:
        ensure_writable(Path(args.out), "--out")
    if args.against is not None:
        paired = _compare_versions(args)
        _report(paired, paired_document(paired), args)
        return int(ExitCode.ROLLOUT_ERRORS if paired.has_too_many_errors else ExitCode.PASS)
    comparison = _compare_estimators(args)
    _report(comparison, comparison_document(comparison), args)
    if comparison.interrupted:
        return int(ExitCode.INTERRUPTED)
    health = [name for arm in comparison.arms for result in arm.repetitions for name in result.health]
    return int(ExitCode.ROLLOUT_ERRORS if "errors" in health else ExitCode.PASS)


def _report(
    comparison: Comparison | PairedComparison, content: dict[str, object], args: argparse.Namespace
) -> None:
    paths = _write(comparison, content, args) if args.out else []
    if args.json:
        print(json.dumps(content))
    else:
        _show(comparison, paths, args)


def _check(args: argparse.Namespace) -> None:
    if args.against is not None:
        for option in ("truth", "repeat"):
            if getattr(args, option) is not None:
                text = f"--{option} cannot be combined with --against"
                raise UsageError(text, "both versions are estimated once")
        return
    for option, example in (("estimators", "mc,ams"), ("budget", "steps=1e6")):
        if getattr(args, option) is None:
            raise UsageError(f"--{option} is required", f"for example --{option} {example}")


def _compare_estimators(args: argparse.Namespace) -> Comparison:
    with _show_estimates(args) as watch:
        return compare(
            args.scenario,
            args.estimators,
            args.budget,
            args.specification,
            overrides=args.set,
            truth=args.truth,
            repeat=REPEAT if args.repeat is None else args.repeat,
            seed=args.seed,
            workers=args.workers,
            watch=watch,
            announce=None if args.quiet else partial(say, error=True),
        )


def _compare_versions(args: argparse.Namespace) -> PairedComparison:
    with _show_estimates(args) as watch:
        return compare_versions(
            args.scenario,
            args.against,
            args.specification,
            estimator=args.estimators,
            budget=args.budget,
            overrides=args.set,
            seed=args.seed,
            workers=args.workers,
            watch=watch,
        )


@contextmanager
def _show_estimates(args: argparse.Namespace) -> Iterator[StudyWatch]:
    """Give a watch that shows one estimate after another in the same lines."""
    with ExitStack() as stack:
        displays: list[Progress] = []

        def watch(label: str, problem: Problem) -> Progress:
            if not displays:
                displays.append(stack.enter_context(Progress(label, problem, display(args))))
            displays[0].label, displays[0].began = label, time.monotonic()
            return displays[0]

        yield watch


def _write(
    comparison: Comparison | PairedComparison, content: dict[str, object], args: argparse.Namespace
) -> list[str]:
    folder, text = Path(args.out), json.dumps(content, indent=2) + "\n"
    if isinstance(comparison, PairedComparison):
        write_files(folder, {"paired.json": text})
        return ["paired.json"]
    write_files(folder, {"comparison.json": text, "comparison.md": markdown(comparison)})
    if args.no_pictures or not can_draw():
        return ["comparison.json", "comparison.md"]
    plot_comparison(comparison).save(folder / "comparison.png")
    return ["comparison.json", "comparison.md", "comparison.png"]


def _show(comparison: Comparison | PairedComparison, written: list[str], args: argparse.Namespace) -> None:
    console = make_console(display(args))
    if args.quiet:
        print_lines(console, comparison.summary())
        return
    first, *others = comparison.headline()
    print_lines(console, [first], "bold")
    print_lines(console, [*others, ""])
    if isinstance(comparison, PairedComparison):
        print_table(console, paired_table(comparison))
    else:
        print_table(console, comparison_table(comparison))
    print_lines(console, comparison.notes(), "yellow")
    if written:
        print_lines(console, [f"written: {', '.join(written)}"])
