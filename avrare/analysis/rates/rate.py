"""Rates of a catalogue: the pilot, the division of the budget, and a run folder for each scene."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from avrare.analysis.rates.catalogue import Catalogue, Phase, load_catalogue
from avrare.analysis.rates.rates import CatalogueRates, compute, divide
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.estimate import check_scenarios, estimate_scenario
from avrare.estimation.loop.checkpoint import Checkpoint, differences
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result
from avrare.results import run_folder
from avrare.results.run import Run
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Scenario

RATES, REFERENCE = "rate.json", "reference"
_BUDGET = "budget.json"

EstimateScene = Callable[[LoadedScenario, Budget | None, Checkpoint], list[Result]]
"""Estimates a scene; the checkpoint keeps its finished chunks."""


def rate(
    path: str | os.PathLike[str],
    *,
    budget: Budget | Mapping[str, float] | str | None = None,
    out: str | os.PathLike[str] | None = None,
    resume: bool = False,
    workers: int = 1,
    executor: str | None = None,
    against: str | None = None,
    watch: Watch | None = None,
    safe: bool = False,
) -> CatalogueRates:
    """Estimate how often each rule is violated per hour and km, over the scenes of a catalogue.

    Args:
        path: Catalogue of scenes with exposures.
        budget: Cost of all scenes together, in rollouts or steps; None: the catalogue's.
        out: Folder of the results; by default a new one under ``runs/``.
        resume: Continue the interrupted run in ``out``.
        workers: Number of processes; changes no number.
        executor: Executor with its options, as for ``--executor``.
        against: ``"CONTROLLER=MODEL"``, such as ``"reference_driver=fsm"``: a controller that drives the same
            scenes in place of the stack's, at the same cost again; the rates are compared with its own.
        watch: Progress display.
        safe: As for ``avrare.load``.

    Raises:
        ScenarioError: The catalogue, or the scenario of a scene, has mistakes.
        UsageError: The budget does not fit, or ``out`` contains another run.
    """

    def estimate(scenario: LoadedScenario, paid: Budget | None, checkpoint: Checkpoint) -> list[Result]:
        journal = cache(lambda name: checkpoint.journal(f"{scenario.name}/{name}"))
        execution = Execution(partial(build_executor, workers, executor), watch or show_nothing, journal)
        return estimate_scenario(scenario, scenario.definition.estimated, paid, execution)

    with safe_mode(safe):
        catalogue = load_catalogue(path)
        scenes = load_scenes(catalogue)
        paid = catalogue.budget(Budget.parse(budget))
        folder = Path(out) if resume and out is not None else choose_folder(catalogue, out)
        return rate_catalogue(catalogue, scenes, paid, folder, resume, estimate, against)


def choose_folder(catalogue: Catalogue, out: str | os.PathLike[str] | None) -> Path:
    """Return the folder for the results of a catalogue, by default a new one under ``runs/``.

    Raises:
        UsageError: It contains the run of a catalogue.
    """
    if out is None:
        return run_folder.make_new_folder([catalogue.document.name])
    folder = Path(out)
    if any((folder / name).exists() for name in ("own", "pilot", "scenes", REFERENCE, RATES, _BUDGET)):
        raise UsageError(f"{folder}: contains the run of a catalogue", "resume it, or choose another folder")
    return folder


def load_scenes(catalogue: Catalogue) -> list[Scenario]:
    """Return the scenario of each scene; none is built."""
    count = len(catalogue.document.scenes)
    return [
        catalogue.scenario(index, "scenes" if catalogue.list_shared_rules(index) else "own", 1)
        for index in range(count)
    ]


def rate_catalogue(
    catalogue: Catalogue,
    scenes: Sequence[Scenario],
    budget: Budget | None,
    folder: Path,
    resume: bool,
    estimate: EstimateScene,
    against: str | None = None,
) -> CatalogueRates:
    """Run the pilot, divide the budget, run the scenes, and write ``rate.json``; see ``rate``."""
    driven = catalogue.drive_by(against) if against is not None else None
    others = load_scenes(driven) if driven is not None else []
    document, count = catalogue.document, len(scenes)
    steps = [scene.steps for scene in scenes]
    if budget is not None:
        divide(catalogue, budget, steps, [{}] * count)  # enough?
    _keep_budgets(catalogue, budget, folder)
    runner = _Runner(catalogue, folder, resume, estimate)
    # 1. The scenes' own estimators; what they find is a part of the rates that the others are to narrow.
    separate = runner.run_own_estimators()
    estimates: list[dict[str, SceneEstimate]] = [dict(scene) for scene in separate]
    if budget is not None:
        # 2. Pilots of the other rules divide the budget, and 3. their shares are run.
        pilot = [_read(run) for run in runner.run("pilot", [document.pilot] * count)]
        rollouts = divide(catalogue, budget, steps, pilot, separate)
        runs = runner.run("scenes", rollouts)
        estimates = [scene | _read(run) for scene, run in zip(estimates, runs, strict=True)]
    broken = [
        entry.name
        for entry, scene in zip(document.scenes, estimates, strict=True)
        if any("errors" in rule.warnings for rule in scene.values())
    ]
    ordered = [{rule: scene[rule] for rule in catalogue.rules} for scene in estimates]
    rates = replace(compute(catalogue, ordered, broken), folder=folder)
    if driven is not None:
        reference = rate_catalogue(driven, others, budget, folder / REFERENCE, resume, estimate)
        rates = replace(rates, driver=against or "", reference=reference)
    _write(folder / RATES, json.dumps(rates.to_dict(), indent=2) + "\n")
    return rates


def _read(run: Run | None, separate: bool = False) -> dict[str, SceneEstimate]:
    return {} if run is None else {name: SceneEstimate(result, separate) for name, result in run.items()}


def _write(path: Path, text: str) -> None:
    with explain_file_errors(f"{path.parent}: cannot write", "choose another folder"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)


def _keep_budgets(catalogue: Catalogue, budget: Budget | None, folder: Path) -> None:
    # Shares of another budget are other runs: they would be refused one by one, without this reason.
    scenes = {
        entry.name: _describe(entry.budget.budget) for entry in catalogue.document.scenes if entry.budget
    }
    path, content = folder / _BUDGET, {"budget": _describe(budget), "scenes": scenes}
    if not path.exists():
        _write(path, json.dumps(content) + "\n")
    elif changes := differences(read_json(path, "choose another folder"), content):
        text = f"{folder}: it was begun with another budget: {'; '.join(changes)}"
        raise UsageError(text, "resume it with the budgets that it had, or choose another folder")


def _describe(budget: Budget | None) -> str | None:
    return None if budget is None else f"{budget.kind}={budget.amount:.15g}"


@dataclass(frozen=True)
class _Runner:
    """Runs the scenes of a catalogue, each into its own folder; finished runs are read from there."""

    catalogue: Catalogue
    folder: Path
    resume: bool
    estimate: EstimateScene

    def run_own_estimators(self) -> list[dict[str, SceneEstimate]]:
        """Return the estimates of each scene by its own estimator; empty for scenes without one."""
        catalogue = self.catalogue
        estimators = {
            index: (
                LoadedScenario(catalogue.scenario(index, "own", 0)),
                catalogue.own_estimator_budget(index),
            )
            for index, rules in enumerate(catalogue.own_rules)
            if rules
        }
        check_scenarios(
            [
                (scenario, budget)
                for scenario, budget in estimators.values()
                if not (self.folder / "own" / scenario.name / "result.json").exists()
            ]
        )
        runs = {
            index: self._run_scene("own", scenario, budget, catalogue.own_rules[index])
            for index, (scenario, budget) in estimators.items()
        }
        return [_read(runs.get(index), True) for index in range(len(catalogue.own_rules))]

    def run(self, phase: Phase, rollouts: Sequence[int]) -> list[Run | None]:
        """Return the run of each scene by its rollouts of Monte Carlo; None where it shares none."""
        runs: list[Run | None] = []
        for index, count in enumerate(rollouts):
            rules = self.catalogue.list_shared_rules(index)
            scenario = LoadedScenario(self.catalogue.scenario(index, phase, count)) if rules else None
            runs.append(None if scenario is None else self._run_scene(phase, scenario, None, rules))
        return runs

    def _run_scene(
        self, phase: Phase, scenario: LoadedScenario, budget: Budget | None, rules: Sequence[str]
    ) -> Run:
        definition = scenario.definition
        folder = run_folder.make_folder(self.folder / phase, definition.name, True)
        finished = run_folder.read_finished(folder, [definition])
        if finished:
            run = finished[0]
        else:
            with run_folder.begin_checkpoint(folder, [definition], budget, self.resume) as checkpoint:
                results = self.estimate(scenario, budget, checkpoint)
                run = Run.of_scenario(definition, results, budget).write(folder)
                checkpoint.remove()
        missing = set(rules) - set(run)
        if missing:
            raise UsageError(
                f"{folder}: its result has no estimate of {', '.join(sorted(missing))}",
                "remove this folder and resume: its rollouts are run again",
            )
        return run
