"""``avrare rate``: rates of rule violations per hour and km, over the scenes of a catalogue."""

from __future__ import annotations

import argparse
import json
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from avrare.analysis.rates.catalogue import TOGETHER, Catalogue, Phase, load_catalogue
from avrare.analysis.rates.rates import CatalogueRates, compute, divide
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import Interrupted, UsageError
from avrare.base.stored_files import read_json
from avrare.cli.options import display
from avrare.cli.output import print_warnings, resumed_folder, say, write_files
from avrare.cli.run import estimate_run
from avrare.estimation.estimate_scenario import check_scenarios
from avrare.estimation.loop.checkpoint import differences
from avrare.estimation.plan.budget import Budget
from avrare.output.html.rate_page import render_rates
from avrare.output.terminal.console import make_console
from avrare.output.terminal.rate_table import print_rates
from avrare.results import run_folder as rundir
from avrare.results.run import Run
from avrare.rollout.executors.interruption import Stopping
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.safe_mode import is_safe
from avrare.scenario.schema import Scenario

_BUDGET = "budget.json"


def execute(args: argparse.Namespace) -> int:
    """Estimate the rates of the catalogue, and return the exit code of the verdict."""
    return int(estimate(args).exit_code)


def estimate(args: argparse.Namespace, command: str = "rate") -> CatalogueRates:
    """Run the pilot, divide the budget, run the scenes, and report.

    Args:
        args: As of ``avrare rate``.
        command: The command that goes on after an interruption.
    """
    catalogue = load_catalogue(args.catalogue)
    budget = catalogue.budget(Budget.parse(args.budget))
    out = _out_folder(args, catalogue)
    try:
        with Stopping() as stop:
            rates = _estimate(args, catalogue, budget, out, stop)
    except (Interrupted, KeyboardInterrupt) as error:
        hint = f"resume with {_resume_command(command, args, out)}"
        raise Interrupted("interrupted, finished chunks are saved", hint) from error
    files = {"rate.json": json.dumps(rates.to_dict(), indent=2) + "\n", "report.html": render_rates(rates)}
    write_files(out, files)
    if args.json:
        print(files["rate.json"], end="")
    else:
        print_rates(make_console(display(args)), rates, quiet=display(args) == "quiet")
        folders = "scenes and own" if any(catalogue.own) else "scenes"
        say(f"results in {out}: rate.json, report.html, a run folder of each scene in {folders}")
    return rates


def _resume_command(command: str, args: argparse.Namespace, out: Path) -> str:
    budget = ["--budget", str(args.budget)] if args.budget is not None else []
    safe = ["--safe"] if is_safe() else []
    return shlex.join(["avrare", command, args.catalogue, "--resume", str(out), *budget, *safe])


def _out_folder(args: argparse.Namespace, catalogue: Catalogue) -> Path:
    if (folder := resumed_folder(args)) is not None:
        return folder
    out = Path(args.out or f"runs/{catalogue.document.name}-{datetime.now():%Y%m%d-%H%M%S}")
    if any((out / name).exists() for name in ("own", "pilot", "scenes", "rate.json", _BUDGET)):
        raise UsageError(
            f"{out}: there is a catalogue's run in this folder", "--resume it, or choose another"
        )
    return out


def _estimate(
    args: argparse.Namespace, catalogue: Catalogue, budget: Budget | None, out: Path, stop: Any
) -> CatalogueRates:
    document = catalogue.document
    count = len(document.scenes)
    scenarios = [_whole(catalogue, index) for index in range(count)]
    steps = [scenario.steps for scenario in scenarios]
    if budget is not None:
        blank = dict.fromkeys(catalogue.rules, SceneEstimate(0, 1))
        divide(catalogue, budget, steps, [blank] * count)  # enough?
    _keep_budgets(catalogue, budget, out)
    for scenario in scenarios:
        print_warnings(scenario.warnings)
    runner = _Runner(args, catalogue, out, stop)
    # 1. The scenes' own estimators; what they find is a part of the rates that the others are to narrow.
    own = runner.run_own()
    found: list[dict[str, SceneEstimate]] = [dict(one) for one in own]
    if budget is not None:
        # 2. Pilots of the other rules divide the budget, and 3. their shares are run.
        pilot = [_read(run) for run in runner.run("pilot", [document.pilot] * count)]
        rollouts = divide(catalogue, budget, steps, pilot, own)
        runs = runner.run("scenes", rollouts)
        found = [estimates | _read(run) for estimates, run in zip(found, runs, strict=True)]
    broken = [
        entry.name
        for entry, estimates in zip(document.scenes, found, strict=True)
        if any("errors" in one.warnings for one in estimates.values())
    ]
    ordered = [{rule: one[rule] for rule in catalogue.rules} for one in found]
    return compute(catalogue, ordered, broken)


def _whole(catalogue: Catalogue, index: int) -> Scenario:
    return catalogue.scenario(index, "scenes" if catalogue.shared(index) else "own", 1)


def _read(run: Run | None, own: bool = False) -> dict[str, SceneEstimate]:
    results = [] if run is None else list(run.values())
    together = Counter(result.estimator for result in results)
    return {
        result.specification: SceneEstimate.of(
            result, (together[result.estimator] if result.estimator in TOGETHER else 1) if own else 0
        )
        for result in results
    }


def _keep_budgets(catalogue: Catalogue, budget: Budget | None, out: Path) -> None:
    # Shares of another budget are other runs: they would be refused one by one, without this reason.
    scenes = {
        entry.name: _describe(entry.budget.budget) for entry in catalogue.document.scenes if entry.budget
    }
    path, content = (
        out / _BUDGET,
        {"budget": _describe(budget), "scenes": scenes},
    )
    if not path.exists():
        write_files(out, {_BUDGET: json.dumps(content) + "\n"})
    elif changes := differences(read_json(path, "choose another --out"), content):
        text = f"{out}: it was begun with another budget: {'; '.join(changes)}"
        raise UsageError(text, "--resume it with the budgets that it had, or choose another --out")


def _describe(budget: Budget | None) -> str | None:
    return None if budget is None else f"{budget.kind}={budget.amount:.15g}"


@dataclass(frozen=True)
class _Runner:
    """Runs the scenes of a catalogue, each into a folder of its own; what is finished there is read."""

    args: argparse.Namespace
    catalogue: Catalogue
    out: Path
    stop: Any

    def run_own(self) -> list[dict[str, SceneEstimate]]:
        """Return the estimates of each scene by its own estimator; empty where it has none."""
        catalogue = self.catalogue
        asked = {
            index: (LoadedScenario(catalogue.scenario(index, "own", 0)), catalogue.own_budget(index))
            for index, rules in enumerate(catalogue.own)
            if rules
        }
        check_scenarios(
            [
                (scenario, budget)
                for scenario, budget in asked.values()
                if not (self.out / "own" / scenario.name / "result.json").exists()
            ]
        )
        runs = {
            index: self._run_scene("own", scenario, budget, catalogue.own[index])
            for index, (scenario, budget) in asked.items()
        }
        return [_read(runs.get(index), True) for index in range(len(catalogue.own))]

    def run(self, phase: Phase, rollouts: Sequence[int]) -> list[Run | None]:
        """Return the run of each scene by so many rollouts of Monte Carlo; None where it shares none."""
        runs: list[Run | None] = []
        for index, count in enumerate(rollouts):
            rules = self.catalogue.shared(index)
            scenario = LoadedScenario(self.catalogue.scenario(index, phase, count)) if rules else None
            runs.append(None if scenario is None else self._run_scene(phase, scenario, None, rules))
        return runs

    def _run_scene(
        self, phase: Phase, scenario: LoadedScenario, budget: Budget | None, rules: Sequence[str]
    ) -> Run:
        definition, resumed = scenario.definition, self.args.resume is not None
        folder = rundir.make_folder(self.out / phase, definition.name, True)
        finished = rundir.read_finished(folder, [definition])
        if finished:
            run = finished[0]
        else:
            with rundir.begin_checkpoint(folder, [definition], budget, resumed) as checkpoint:
                results = estimate_run(scenario, self.args, budget, checkpoint, self.stop)
                run = Run.of_scenario(definition, results, budget).write(folder)
                checkpoint.remove()
        missing = set(rules) - set(run)
        if missing:
            raise UsageError(
                f"{folder}: its result has no estimate of {', '.join(sorted(missing))}",
                "remove this folder and --resume: its rollouts are run again",
            )
        return run
