"""``avrare compare``: estimators with equal budgets, or two versions of a stack on the same noise."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.analysis.compare.case import (
    REFERENCE_PREFIX,
    GroundTruth,
    parse_truth,
    reference_case,
    scenario_case,
)
from avrare.analysis.compare.estimator_options import parse_arms, split_settings
from avrare.analysis.compare.paired_comparison import PairedComparison, compare_pairs
from avrare.analysis.compare.study import StudyDesign, compare
from avrare.base.atomic_files import ensure_writable, explain_file_errors
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import REPEAT, display
from avrare.cli.output import can_draw, write_files
from avrare.estimation.budget import Budget
from avrare.plugin.registry import default_registry
from avrare.report.documents.comparison_documents import comparison_document, paired_document
from avrare.report.plots import comparison_plot
from avrare.report.terminal import comparison_table as estimators
from avrare.report.terminal import paired_table as versions
from avrare.report.terminal.comparison_table import markdown
from avrare.report.terminal.console import make_console, print_lines, print_table
from avrare.report.terminal.progress_line import Progress
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.testing.problems import reference_problems

_PAIRED_ROLLOUTS = 1000


def execute(args: argparse.Namespace) -> int:
    """Compare, print and write the comparison."""
    if args.scenario == "problem:":
        for problem in reference_problems():
            print(f"{problem.id:<26}{problem.probability:<12.4g}{problem.text}")
        return int(ExitCode.PASS)
    paired = args.against is not None
    _check(args)
    if args.out:
        ensure_writable(Path(args.out), "--out")
    comparison = _compare_versions(args) if paired else _compare_estimators(args)
    content = paired_document(comparison) if paired else comparison_document(comparison)
    written = _write(comparison, content, args) if args.out else []
    if args.json:
        print(json.dumps(content))
    else:
        _show(comparison, written, args)
    if paired:
        return int(ExitCode.ROLLOUT_ERRORS if comparison.has_too_many_errors else ExitCode.PASS)
    if comparison.interrupted:
        return int(ExitCode.INTERRUPTED)
    health = [name for arm in comparison.arms for one in arm.repetitions for name in one.health]
    return int(ExitCode.ROLLOUT_ERRORS if "errors" in health else ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    if args.against is not None:
        for option in ("estimators", "truth", "repeat"):
            if getattr(args, option) is not None:
                text = f"--{option} cannot be combined with --against"
                raise UsageError(text, "--against runs Monte Carlo on both versions")
        return
    for option, example in (("estimators", "mc,ams"), ("budget", "steps=1e6")):
        if getattr(args, option) is None:
            raise UsageError(f"--{option} is required", f"for example --{option} {example}")


def _budget(text: str) -> Any:
    budget = Budget.parse(text)
    assert budget is not None
    if budget.kind == "seconds":
        raise UsageError(
            "--budget seconds=N is not comparable: its cost differs between machines and runs",
            "give steps=N or rollouts=N",
        )
    return budget


def _compare_estimators(args: argparse.Namespace) -> Any:
    budget = _budget(args.budget)
    truth = parse_truth(args.truth) if args.truth is not None else None
    scenario_settings, estimator_settings = split_settings(args.set)
    case = _case(args, scenario_settings, truth)
    arms = parse_arms(args.estimators, estimator_settings, case.estimator, default_registry())
    repeat = REPEAT if args.repeat is None else args.repeat
    design = StudyDesign(budget, repeat, case.seed if args.seed is None else args.seed, args.workers)
    with Progress(case.name, case.problem, display(args)) as progress:

        def watch(name: str) -> Any:
            progress.label, progress.began = f"{case.name}  {name}", time.monotonic()
            return progress

        return compare(case, arms, design, watch, truth if isinstance(truth, int) else None)


def _case(args: argparse.Namespace, overrides: list[str], truth: Any) -> Any:
    if not args.scenario.startswith(REFERENCE_PREFIX):
        case = scenario_case(args.scenario, args.specification, overrides)
        return replace(case, truth=truth) if isinstance(truth, GroundTruth) else case
    case = reference_case(args.scenario.removeprefix(REFERENCE_PREFIX))
    for option, given in (
        ("--truth", truth), ("--specification", args.specification), ("--set scenario.KEY", overrides),
    ):  # fmt: skip
        if given:
            raise UsageError(
                f"{option} cannot be used with {args.scenario}",
                "a reference problem has one formula and a known probability",
            )
    return case


def _compare_versions(args: argparse.Namespace) -> Any:
    both, second_only = _split_settings(args.set)
    definitions = (load(args.scenario, both), load(args.against, [*both, *second_only]))
    problems = [LoadedScenario(one).problem(args.specification or one.estimated) for one in definitions]
    seed = definitions[0].seed if args.seed is None else args.seed
    executor = build_executor(args.workers)
    rollouts = _paired_rollouts(args.budget, problems[0].steps)
    with Progress("", problems[0], display(args)) as progress:

        def watch(number: int) -> Progress:
            progress.label = f"{(args.scenario, args.against)[number]}  {number + 1} of 2"
            progress.began = time.monotonic()
            return progress

        pairs = compare_pairs(problems[0], problems[1], rollouts, seed, executor, watch)
    return PairedComparison((args.scenario, args.against), definitions, tuple(pairs), rollouts, seed)


def _split_settings(given: list[str]) -> tuple[list[str], list[str]]:
    both: list[str] = []
    second_only: list[str] = []
    for text in given:
        prefix, _, rest = text.partition(".")
        if prefix not in ("scenario", "against") or not rest:
            raise UsageError(
                f"--set {text}: with --against, KEY must begin with scenario. or against.",
                "write --set scenario.KEY=VALUE for both, --set against.KEY=VALUE for the second only",
            )
        (both if prefix == "scenario" else second_only).append(rest)
    return both, second_only


def _paired_rollouts(text: str | None, steps: int) -> int:
    if text is None:
        return _PAIRED_ROLLOUTS
    budget = _budget(text)
    rollouts = int(budget.amount // (max(steps, 1) if budget.kind == "steps" else 1))
    if rollouts < 1:
        raise UsageError(f"--budget {text} does not cover one rollout of {steps} steps")
    return rollouts


def _write(comparison: Any, content: dict[str, Any], args: argparse.Namespace) -> list[str]:
    folder, text = Path(args.out), json.dumps(content, indent=2) + "\n"
    if args.against is not None:
        write_files(folder, {"paired.json": text})
        return ["paired.json"]
    write_files(folder, {"comparison.json": text, "comparison.md": markdown(comparison)})
    if args.no_pictures or not can_draw():
        return ["comparison.json", "comparison.md"]
    with explain_file_errors(f"{folder}: cannot write", "choose another --out"):
        comparison_plot.draw(comparison, folder / "comparison.png")
    return ["comparison.json", "comparison.md", "comparison.png"]


def _show(comparison: Any, written: list[str], args: argparse.Namespace) -> None:
    console = make_console(display(args))
    paired = args.against is not None
    tables: Any = versions if paired else estimators
    if args.quiet:
        print_lines(console, tables.summary_lines(comparison))
        return
    first, *others = [versions.headline(comparison)] if paired else estimators.headline(comparison)
    print_lines(console, [first], "bold")
    print_lines(console, [*others, ""])
    print_table(
        console, versions.paired_table(comparison) if paired else estimators.comparison_table(comparison)
    )
    print_lines(console, tables.note_lines(comparison), "yellow")
    if written:
        print_lines(console, [f"written: {', '.join(written)}"])
