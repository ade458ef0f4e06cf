"""Estimates of the specifications of a scenario or of a problem (``avrare.estimate``, ``estimate_all``)."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from avrare.base import version
from avrare.base.errors import HealthWarning, UsageError
from avrare.base.renderers import render
from avrare.estimation.combine.cross_check import parse_cross_check, subtract_check
from avrare.estimation.combine.ensemble import include_model
from avrare.estimation.combine.specifications import (
    Execution,
    Watch,
    check_specifications,
    estimate_specifications,
)
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import Progress
from avrare.estimation.loop.preflight import Clearance
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Estimator, Settings
from avrare.estimation.result.result import Origin, Result, Results
from avrare.logic.formula import Formula
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.rollout.twin import check_twin
from avrare.scenario.cross_check import CrossCheck
from avrare.scenario.validation import check_options

_MEMBER_KEY = 0xE25E


def check_scenario(
    scenario: LoadedScenario, budget: Budget | None = None, specifications: Sequence[str] | None = None
) -> list[Clearance]:
    """Return the clearance of each estimate of a scenario, before its first rollout.

    Args:
        scenario: Scenario.
        budget: Budget of each estimate.
        specifications: Those that are estimated; None: all that the scenario has estimated.

    Raises:
        UsageError: One of the estimates could not begin.
    """
    problem = scenario.problem(specifications or scenario.definition.estimated)
    if problem.twin is not None:
        check_twin(problem, problem.twin.problem, problem.twin.cost)
    return check_specifications(problem, scenario.estimator(), _settings(scenario, budget))


def check_scenarios(estimates: Sequence[tuple[LoadedScenario, Budget | None]]) -> None:
    """Check several scenarios before the first rollout; raise the first reason against their estimates.

    A single estimate is checked as it begins.

    Raises:
        UsageError: An estimate could not begin.
    """
    for scenario, budget in estimates:
        several = scenario.estimator().single and len(scenario.definition.estimated) > 1
        if several or len(estimates) > 1:
            try:
                check_scenario(scenario, budget)
            except UsageError as error:
                place = f"{scenario.name}: " if len(estimates) > 1 else ""
                raise UsageError(f"{place}{error.message}", error.hint) from None


def estimate_scenario(
    scenario: LoadedScenario,
    specifications: Sequence[str],
    budget: Budget | None,
    execution: Execution,
    *,
    seed: int | None = None,
    note: str = "",
    goal: float | None = None,
) -> list[Result]:
    """Estimate specifications in one pass where the scenario's estimator can, else one after the other.

    Args:
        scenario: Scenario.
        specifications: Their names.
        budget: Budget of each estimate.
        execution: Runs the estimates.
        seed: Seed; None: the scenario's.
        note: Text that is added to the label of each estimate.
        goal: Relative error that ``auto`` reaches where it is given no size; None: its own.
    """
    definition, settings = scenario.definition, replace(_settings(scenario, budget), goal=goal)
    if seed is not None:
        settings = replace(settings, seed=seed)
    estimates = estimate_specifications(
        scenario.problem(specifications),
        scenario.estimator(),
        settings,
        execution,
        definition.cross_check,
        title=f"{definition.name} ({len(specifications)} specifications)",
        note=note,
    )
    results = [result for _, result in estimates]
    members = definition.members
    if not members:
        return results
    shared = None if budget is None else replace(budget, amount=budget.amount / len(members))

    def estimate_member(number: int, name: str) -> Result:
        key = np.random.SeedSequence(settings.seed, spawn_key=(_MEMBER_KEY, number))
        return estimate_scenario(
            LoadedScenario(members[number]),
            [name],
            shared,
            replace(execution, journal=lambda first: execution.journal(f"{first}+model{number}")),
            seed=int(key.generate_state(1, np.uint64)[0]),
            note=f"  model {number + 1} of {len(members)}",
            goal=goal,
        )[0]

    return include_model(scenario, results, estimate_member)


def _settings(scenario: LoadedScenario, budget: Budget | None) -> Settings:
    definition = scenario.definition
    return Settings(
        definition.seed,
        definition.confidence,
        subtract_check(budget, definition.cross_check),
        definition.max_error_rate,
        definition.suppress,
    )


def estimate(
    problem: Problem,
    estimator: str = "mc",
    *,
    seed: int = 0,
    workers: int = 1,
    confidence: float = 0.95,
    budget: Budget | Mapping[str, float] | str | None = None,
    suppress: Sequence[str] = (),
    checkpoint: str | os.PathLike[str] | None = None,
    cross_check: CrossCheck | Mapping[str, object] | bool = False,
    progress: Progress | bool = False,
    **options: object,
) -> Result:
    """Estimate the failure probability of ``problem``.

    Each health warning of the result is also given as a ``HealthWarning``.

    Args:
        problem: Problem with one specification; ``estimate_all`` takes several.
        estimator: Name of an installed estimator: "mc", "ams", ...
        seed: The same seed gives the same bits, for any number of workers.
        workers: Number of processes.
        confidence: Level of the interval, in (0, 1).
        budget: "steps=1e6", {"rollouts": 1000}, ...; None: the estimator's own options decide.
        suppress: Names of health warnings to leave out of the result.
        checkpoint: Folder in which the outcome of every chunk (``Problem(chunk=...)``) is kept until the
            estimate is complete. After an interruption the same call resumes from there with the same bits,
            for any number of workers; a call that differs is refused.
        cross_check: Check the estimate by a smaller one of another family: True, or options such as
            {"estimator": "ess", "share": 0.15}. A budget pays for both.
        progress: True: a live line, in a terminal or a notebook. A function is called after every chunk with
            an ``Info``: rollouts, goal, failures, probability so far, ...
        **options: The estimator's options, per run: ``rollouts``, ``particles``, ``discard``, ``runs``, ...

    Raises:
        UsageError: Arguments are unknown or invalid, the checkpoint belongs to another call, or the system
            breaks a rule that the estimator relies on, as by changing its state in place.
        PluginError: No installed plugin provides the estimator.
    """
    _check_problem(problem)
    if len(problem.names) != 1:
        raise UsageError(
            f"the problem has {len(problem.names)} specifications; estimate gives one result",
            "avrare.estimate_all(problem, ...) estimates all of them",
        )
    call = _Call(seed, workers, confidence, budget, suppress, checkpoint, cross_check, progress, options)
    return _warn(call.estimate(problem, estimator))[0]


def estimate_all(
    problem: Problem,
    estimator: str = "mc",
    *,
    seed: int = 0,
    workers: int = 1,
    confidence: float = 0.95,
    budget: Budget | Mapping[str, float] | str | None = None,
    suppress: Sequence[str] = (),
    checkpoint: str | os.PathLike[str] | None = None,
    cross_check: CrossCheck | Mapping[str, object] | bool = False,
    progress: Progress | bool = False,
    **options: object,
) -> Results:
    """Estimate the failure probability of each specification of ``problem``.

    Monte Carlo judges all specifications on the same rollouts; other estimators take one after the other,
    and a budget is for each. Arguments and errors are those of ``estimate``.
    """
    _check_problem(problem)
    call = _Call(seed, workers, confidence, budget, suppress, checkpoint, cross_check, progress, options)
    return Results(_warn(call.estimate(problem, estimator)))


@dataclass(frozen=True)
class _Call:
    seed: int
    workers: int
    confidence: float
    budget: Any
    suppress: Sequence[str]
    checkpoint: Any
    cross_check: Any
    progress: Progress | bool
    options: dict[str, object]

    def estimate(self, problem: Problem, name: str) -> list[Result]:
        if not isinstance(self.checkpoint, (str, os.PathLike, type(None))):
            raise UsageError(f"checkpoint must be the path of a folder, not {self.checkpoint!r}")
        if self.workers != 1:
            from avrare.rollout.executors.processes import exit_unguarded_worker

            exit_unguarded_worker()  # before the checkpoint is opened, which the parent holds
        check = parse_cross_check(self.cross_check, name)
        budget = subtract_check(Budget.parse(self.budget), check)
        suppress = (self.suppress,) if isinstance(self.suppress, str) else tuple(self.suppress)
        settings = Settings(self.seed, self.confidence, budget, suppress=suppress)
        config = _config(name, self.options)
        built = _estimator(name, config)

        if built.single and len(problem.names) > 1:  # a single estimate is checked as it begins
            check_specifications(problem, built, settings)
        watch = watch_with(self.progress, name, self.confidence)
        execution = Execution(partial(build_executor, self.workers), watch)
        call = self._describe(built)

        def complete(execution: Execution) -> list[Result]:
            return [
                replace(result, origin=Origin(partial(_pair, part, built), self.seed, call))
                for part, result in estimate_specifications(problem, built, settings, execution, check)
            ]

        if self.checkpoint is None:
            return complete(execution)
        task = _task(problem, name, config, settings)
        if check is not None:
            task["cross_check"] = check.model_dump()
        with Checkpoint.open(Path(self.checkpoint), task).hold() as saved:
            results = complete(replace(execution, journal=saved.journal))
            saved.remove()
        return results

    def _describe(self, estimator: Estimator) -> str:
        options = "".join(f", {name}={value!r}" for name, value in self.options.items())
        return f'avrare.estimate(problem, "{estimator.name}", seed={self.seed}{options})'


def watch_with(progress: Progress | bool, estimator: str, confidence: float) -> Watch:
    """Return the display that ``progress`` asks for: a function, a live line, or none."""

    def watch(label: str, problem: Problem) -> AbstractContextManager[Progress | None]:
        if callable(progress):
            return nullcontext(progress)
        if not progress:
            return nullcontext()
        line: AbstractContextManager[Progress] = render(
            "show_progress", label, problem, confidence if estimator == "mc" else None
        )
        return line

    return watch


def _pair(problem: Problem, estimator: Estimator) -> tuple[Problem, Estimator]:
    return problem, estimator


def _check_problem(problem: object) -> None:
    if not isinstance(problem, Problem):
        raise UsageError(
            f"estimate needs a Problem, not {type(problem).__name__}",
            "avrare.Problem(system, specification, steps), or avrare.load(path).problem(name)",
        )


def _warn(results: list[Result]) -> list[Result]:
    for result in results:
        for name, message in result.health.items():
            warnings.warn(f"{result.specification}: {name}: {message}", HealthWarning, stacklevel=3)
    return results


_ARGUMENTS = ("seed", "workers", "confidence", "budget", "suppress", "checkpoint", "cross_check", "progress")
"""Arguments of ``estimate`` that are not options: suggested for a misspelt option."""


def _config(name: str, options: dict[str, object]) -> BaseModel:
    if not isinstance(name, str):
        raise UsageError(
            f"estimator must be a name, not {name!r}", 'such as "mc"; `avrare plugins` lists all'
        )
    component = default_registry().get("estimator", name)
    config: BaseModel = check_options(component.load_config(), name, options, other_keys=_ARGUMENTS)
    return config


def _estimator(name: str, config: BaseModel) -> Estimator:
    estimator: Estimator = default_registry().get("estimator", name).build(config)
    return estimator


def _task(problem: Problem, name: str, config: BaseModel, settings: Settings) -> dict[str, object]:
    # names do not identify a system or a score: the loop replays a stored chunk to compare those
    row = default_registry().find("estimator", name)
    formula = problem.monitors[0].formula
    task = {
        "estimator": name,
        "options": config.model_dump(),
        "settings": asdict(settings),
        "problem": {
            "system": type(problem.system).__qualname__,
            "steps": problem.steps,
            "chunk": problem.named_chunk,
            "noise_size": problem.noise_size,
            "formula": formula.text if formula is not None else None,
            "score": problem.score.text if isinstance(problem.score, Formula) else problem.score,
            **(
                {}
                if problem.twin is None
                else {"twin": [type(problem.twin.problem.system).__qualname__, problem.twin.cost]}
            ),
        },
        "versions": {"avrare": version.__version__, row.distribution: row.version},
    }
    content: dict[str, object] = json.loads(json.dumps(task, default=_plain))
    return content


def _plain(value: object) -> object:
    if hasattr(value, "tolist"):
        return value.tolist()
    return getattr(value, "__qualname__", type(value).__qualname__)
