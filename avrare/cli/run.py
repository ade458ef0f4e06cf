"""``avrare run``: estimate the failure probability of every specification of a scenario."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.cli.doubts import warn
from avrare.cli.parser import add_scenario_arguments
from avrare.errors import ExitCode, UsageError
from avrare.scenario.schema import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``avrare run``."""
    add_scenario_arguments(parser)
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of all random numbers; the scenario's by default"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument(
        "--executor", metavar="NAME", help="where the work runs; default: processes if workers > 1"
    )
    parser.add_argument(
        "--budget", metavar="KIND=N", help="steps=N, rollouts=N or seconds=N, for each estimate"
    )
    parser.add_argument(
        "--until", metavar="relative_error=X", help="run Monte Carlo until the estimate is as exact as that"
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the results; default: a new one under runs/")
    parser.add_argument("--json", action="store_true", help="print result.json and nothing else on stdout")
    parser.add_argument("--no-pictures", action="store_true", help="draw nothing")


def execute(args: argparse.Namespace) -> int:
    """Run the scenarios one after another."""
    from avrare.estimation.budget import Budget
    from avrare.scenario.load import load

    if args.workers < 1:
        raise UsageError(f"--workers must be at least 1, not {args.workers}")
    budget = Budget.parse(args.budget)
    overrides = [*args.set, *([f"seed={args.seed}"] if args.seed is not None else [])]
    overrides += _until(args.until)
    scenarios = [load(path, overrides, args.estimator) for path in args.scenarios]
    for scenario in scenarios:
        warn(scenario.warnings)
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        raise UsageError(
            f"two scenarios have the same name: {', '.join(sorted(names))}", "run them one at a time"
        )
    contents = [_run(scenario, args, budget, several=len(scenarios) > 1) for scenario in scenarios]
    if args.json:
        print(json.dumps(contents[0] if len(contents) == 1 else contents))
    troubled = any("errors" in entry["health"] for content in contents for entry in content["estimates"])
    return int(ExitCode.ROLLOUT_ERRORS if troubled else ExitCode.PASS)


def _until(text: str | None) -> list[str]:
    """The override that ``--until`` stands for."""
    if text is None:
        return []
    key, _, value = text.partition("=")
    if key != "relative_error" or not value:
        raise UsageError(f"--until {text!r} is not understood", "write --until relative_error=0.1")
    return [f"estimator.relative_error={value}"]


def _run(definition: Scenario, args: argparse.Namespace, budget: Any, several: bool) -> dict[str, Any]:
    from avrare.build.scenario import BuildableScenario
    from avrare.record import rundir

    folder = rundir.choose(args.out, definition.name, several)
    scenario = BuildableScenario(definition)
    results = _estimates(scenario, args, budget)
    content = rundir.document(definition, results)
    rundir.write(folder, definition, content, results)
    pictures = [] if args.no_pictures else _draw(scenario, results, folder)
    if not args.json:
        _show(definition, results, folder, pictures)
    return content


def _estimates(scenario: Any, args: argparse.Namespace, budget: Any) -> list[Any]:
    """One pass for all specifications where the estimator can, else one run for each."""
    from avrare.estimation.loop import Settings, run
    from avrare.report.console import Progress

    definition = scenario.definition
    estimator = scenario.estimator()
    groups = [(name,) for name in definition.estimated] if estimator.single else [definition.estimated]
    settings = Settings(
        definition.seed, definition.confidence, budget, definition.max_error_rate, definition.suppress,
        replay=True,
    )  # fmt: skip
    results = []
    for group in groups:
        problem = scenario.problem(group)
        label = group[0] if len(group) == 1 else f"{definition.name} ({len(group)} specifications)"
        with Progress(f"{label}  {estimator.name}", problem) as progress:
            results += run(problem, estimator, _executor(args), settings, progress)
    return [_judged(definition, result) for result in results]


def _judged(definition: Scenario, result: Any) -> Any:
    """With the verdict of the scenario's thresholds; of several, the worst."""
    from avrare.estimation.verdict import verdict

    found = {
        verdict(result, threshold.limit, threshold.strict, threshold.confidence)
        for threshold in definition.thresholds
        if threshold.specification == result.specification
    }
    worst = next((name for name in ("fail", "inconclusive", "pass") if name in found), None)
    return replace(result, verdict=worst)


def _executor(args: argparse.Namespace) -> Any:
    from avrare.plugin.registry import default_registry

    name = args.executor or ("processes" if args.workers > 1 else "serial")
    component = default_registry().require("executor", name)
    config = component.load_config()(workers=args.workers)
    return component.load_factory()(config, None)


def _draw(scenario: Any, results: Sequence[Any], folder: Path) -> list[Path]:
    """Pictures of the nominal and the worst rollouts, where there is a road and matplotlib."""
    from avrare.report import picture

    if scenario.scene is None:
        return []
    if not picture.available():
        print("no pictures: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
        return []
    return picture.draw_run(scenario, results, folder)


def _show(definition: Scenario, results: Sequence[Any], folder: Path, pictures: Sequence[Path]) -> None:
    from rich.console import Console

    from avrare.report.console import notes, table

    console = Console(soft_wrap=True, highlight=False)
    how = f"{results[0].estimator}, seed {definition.seed}, {definition.confidence:.0%} intervals"
    title = f"{definition.name}  {how}"
    console.print(table(title, results))
    for line in notes(results):
        console.print(line, style="yellow", markup=False)
    console.print(f"results in {folder}" + "".join(f"\n  {path.name}" for path in pictures), markup=False)
