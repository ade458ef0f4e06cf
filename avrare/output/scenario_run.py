"""Runs of scenario files from Python: what ``avrare run`` does, with typed results."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.estimate import check_scenarios, estimate_scenario, watch_with
from avrare.estimation.loop.loop import Progress
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Estimator
from avrare.estimation.result.result import Origin, Result
from avrare.estimation.result.verdict import with_verdict
from avrare.results import run_folder
from avrare.results.run import Run
from avrare.results.run_folder import call_back
from avrare.rollout.executors.processes import exit_unguarded_worker
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode


def run(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    out: str | os.PathLike[str] | None = None,
    *,
    estimator: str | None = None,
    budget: Budget | Mapping[str, float] | str | None = None,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | bool = False,
    safe: bool = False,
) -> Run:
    """Estimate every specification of a scenario and write the run folder, as ``avrare run`` does.

    Args:
        path: YAML file.
        overrides: Settings as for ``--set``, for example ``["seed=3", "estimator.particles=50"]``; a
            string is a single one.
        out: Run folder; by default a new one under ``runs/``.
        estimator: Name of another estimator, with its default options.
        budget: As for ``avrare.estimate``.
        workers: Number of processes; changes no bit of a result.
        resume: Continue the interrupted run in ``out``.
        progress: As for ``avrare.estimate``.
        safe: Refuse code outside installed plugins, and files outside the scenario's folder.

    Raises:
        ScenarioError: The file has problems; the message lists all of them with line and column.
        UsageError: The arguments or the parts do not fit, or ``out`` contains another run.
        PluginError: A plugin is missing.
    """
    if workers != 1:
        exit_unguarded_worker()  # before the run folder is asked for, which the parent holds
    with safe_mode(safe):
        definition = load(path, overrides, estimator)
    scenario, limit = LoadedScenario(definition), Budget.parse(budget)
    if resume and out is None:
        raise UsageError(
            "resume needs the folder of the interrupted run", "avrare.run(path, out=FOLDER, resume=True)"
        )
    _ = scenario.stack  # what cannot be built leaves no folder
    check_scenarios([(scenario, limit)])
    home = run_folder.make_new_folder([definition.name]) if out is None else Path(out)
    folder = run_folder.make_folder(home, definition.name, several=False)
    with run_folder.begin_checkpoint(home, [definition], limit, resume) as checkpoint:
        journal = cache(lambda name: checkpoint.journal(f"{definition.name}/{name}"))
        watch = watch_with(progress, definition.estimator.plugin, definition.confidence)
        execution = Execution(partial(build_executor, workers), watch, journal)
        results = estimate_scenario(scenario, definition.estimated, limit, execution)
        finished = Run.of_scenario(definition, [_finish(scenario, result) for result in results], limit)
        finished = finished.write(folder)
        checkpoint.remove()
    return replace(finished, replies=tuple(call_back(finished)))


def _finish(scenario: LoadedScenario, result: Result) -> Result:
    definition = scenario.definition
    call = f"avrare.run({definition.path!r})"
    origin = Origin(partial(_build, scenario, result.specification), definition.seed, call)
    return with_verdict(replace(result, origin=origin), definition.thresholds)


def _build(scenario: LoadedScenario, name: str) -> tuple[Problem, Estimator]:
    return scenario.problem(name), scenario.estimator()
