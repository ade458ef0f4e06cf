"""Estimates of the specifications of a problem (``avrare.estimate``, ``estimate_all``) or a scenario."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from avrare.base import version
from avrare.base.errors import HealthWarning, UsageError
from avrare.base.renderers import render
from avrare.estimation.combine.cross_check import (
    add_cross_check,
    count_sharers,
    parse_cross_check,
    subtract_check,
)
from avrare.estimation.combine.ensemble import include_model
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import Progress, Settings, check_estimate, run
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.memory import Forecast
from avrare.estimation.plan.plan import Estimator, Journal
from avrare.estimation.result.result import Origin, Result, Results
from avrare.logic.formula import find_formula
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.work import Executor, build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.rollout.twin import check_twin
from avrare.scenario.schema import CrossCheck
from avrare.scenario.validation import check_options


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
    cross_check: CrossCheck | Mapping[str, Any] | bool = False,
    progress: Progress | bool = False,
    **options: Any,
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
    return _told(call.estimate(problem, estimator))[0]


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
    cross_check: CrossCheck | Mapping[str, Any] | bool = False,
    progress: Progress | bool = False,
    **options: Any,
) -> Results:
    """Estimate the failure probability of each specification of ``problem``.

    Monte Carlo judges all specifications on the same rollouts; other estimators take one after the other,
    and a budget is for each. Arguments and errors are those of ``estimate``.
    """
    _check_problem(problem)
    call = _Call(seed, workers, confidence, budget, suppress, checkpoint, cross_check, progress, options)
    return Results(_told(call.estimate(problem, estimator)))


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
    options: dict[str, Any]

    def estimate(self, problem: Problem, name: str) -> list[Result]:
        if not isinstance(self.checkpoint, (str, os.PathLike, type(None))):
            raise UsageError(f"checkpoint must be the path of a folder, not {self.checkpoint!r}")
        if self.workers != 1:
            from avrare.rollout.executors.worker_process import exit_if_unguarded

            exit_if_unguarded()  # before the checkpoint is opened, which the parent holds
        check = parse_cross_check(self.cross_check, name)
        paid = subtract_check(Budget.parse(self.budget), check)
        suppress = (self.suppress,) if isinstance(self.suppress, str) else tuple(self.suppress)
        settings = Settings(self.seed, self.confidence, paid, suppress=suppress)
        built = _estimator(name, self.options)

        def complete(journal: Callable[[str], Journal | None]) -> list[Result]:
            def execute(
                problem: Problem, used: Estimator, settings: Settings, part: str = _CHECK
            ) -> list[Result]:
                saved = journal(f"{problem.names[0]}{part}")
                with self._watch(problem, used) as progress:
                    return run(problem, used, build_executor(self.workers), settings, progress, saved)

            found = []
            for group in problem.separate() if built.single else [problem]:
                results = execute(group, built, settings, "")
                for part, result in zip(group.separate(), results, strict=True):
                    if check is not None:
                        one = partial(_first, execute)
                        parts = count_sharers(result, len(results))
                        result = add_cross_check(part, result, check, settings, one, parts=parts)
                    origin = Origin(partial(_pair, part, built), self.seed, self._describe(built))
                    found.append(dataclasses.replace(result, origin=origin))
            return found

        if self.checkpoint is None:
            return complete(lambda name: None)
        task = _task(problem, name, built, settings)
        if check is not None:
            task["cross_check"] = check.model_dump()
        with Checkpoint.open(Path(self.checkpoint), task).held() as saved:
            results = complete(saved.journal)
            saved.remove()
        return results

    def _describe(self, estimator: Estimator) -> str:
        options = "".join(f", {name}={value!r}" for name, value in self.options.items())
        return f'avrare.estimate(problem, "{estimator.name}", seed={self.seed}{options})'

    def _watch(self, problem: Problem, estimator: Estimator) -> AbstractContextManager[Progress | None]:
        if callable(self.progress):
            return nullcontext(self.progress)
        if not self.progress:
            return nullcontext()
        line: AbstractContextManager[Progress] = render(
            "show_progress", problem, estimator.name, self.confidence
        )
        return line


def _pair(problem: Problem, estimator: Estimator) -> tuple[Problem, Estimator]:
    return problem, estimator


def _first(execute: Callable[..., list[Result]], *arguments: Any) -> Result:
    return execute(*arguments)[0]


def _check_problem(problem: object) -> None:
    if not isinstance(problem, Problem):
        raise UsageError(
            f"estimate needs a Problem, not {type(problem).__name__}",
            "avrare.Problem(system, specification, steps), or avrare.load(path).problem(name)",
        )


def _told(results: list[Result]) -> list[Result]:
    for result in results:
        for name, message in result.health.items():
            warnings.warn(f"{result.specification}: {name}: {message}", HealthWarning, stacklevel=3)
    return results


_MEMBER_KEY = 0xE25E
_CHECK = "+check"
"""End of the name of a cross-check's journal; no specification has a "+" in its name."""
_ARGUMENTS = ("seed", "workers", "confidence", "budget", "suppress", "checkpoint", "cross_check", "progress")
"""Arguments of ``estimate`` that are not options: suggested for a misspelt option."""


def _estimator(name: str, options: dict[str, Any]) -> Estimator:
    if not isinstance(name, str):
        raise UsageError(
            f"estimator must be a name, not {name!r}", 'such as "mc"; `avrare plugins` lists all'
        )
    component = default_registry().get("estimator", name)
    config = check_options(component.load_config(), name, options, other_keys=_ARGUMENTS)
    return component.load_factory()(config, None)  # type: ignore[no-any-return]


def _task(problem: Problem, name: str, estimator: Estimator, settings: Settings) -> dict[str, Any]:
    # names do not identify a system or a score: the loop replays a stored chunk to compare those
    row = default_registry().find("estimator", name)
    formula = find_formula(problem.monitors[0])
    task = {
        "estimator": name,
        "options": getattr(getattr(estimator, "config", None), "model_dump", dict)(),
        "settings": dataclasses.asdict(settings),
        "problem": {
            "system": type(problem.system).__qualname__,
            "steps": problem.steps,
            "chunk": problem.named_chunk,
            "noise_size": problem.noise_size,
            "formula": formula.text if formula is not None else None,
            "score": getattr(problem.score, "text", problem.score),
            **(
                {}
                if problem.twin is None
                else {"twin": [type(problem.twin.problem.system).__qualname__, problem.twin.cost]}
            ),
        },
        "versions": {"avrare": version.__version__, row.distribution: row.version},
    }
    return json.loads(json.dumps(task, default=_plain))  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    return getattr(value, "__qualname__", type(value).__qualname__)


Watch = Callable[[str, Problem], AbstractContextManager[Progress | None]]
"""Called with a label and a problem as each estimate begins; gives its progress display."""


def check_scenario(scenario: LoadedScenario, budget: Budget | None = None) -> tuple[dict[str, str], Forecast]:
    """Return the health warnings on a scenario's system, found by a few steps, and the memory of a run.

    Raises:
        UsageError: The scenario cannot be estimated.
    """
    definition, estimator = scenario.definition, scenario.estimator()
    problem = scenario.problem(definition.estimated[:1] if estimator.single else definition.estimated)
    if problem.twin is not None:
        check_twin(problem, problem.twin.problem, problem.twin.cost)
    return check_estimate(problem, estimator, _settings(scenario, budget))


def _settings(scenario: LoadedScenario, budget: Budget | None) -> Settings:
    definition = scenario.definition
    return Settings(
        definition.seed,
        definition.confidence,
        subtract_check(budget, definition.cross_check),
        definition.max_error_rate,
        definition.suppress,
    )


def estimate_specifications(
    scenario: LoadedScenario,
    specifications: Sequence[str],
    budget: Budget | None,
    start_executor: Callable[[], Executor],
    watch: Watch,
    *,
    seed: int | None = None,
    note: str = "",
    journal: Callable[[str], Journal] | None = None,
    stop: Callable[[], bool] | None = None,
) -> list[Result]:
    """Estimate specifications in one pass where the estimator can, else one after the other.

    ``seed`` replaces the scenario's, ``note`` is added to the label of each estimate, ``journal`` gives the
    journal of an estimate by its first specification, and ``stop`` is as in ``run``.
    """
    definition, estimator = scenario.definition, scenario.estimator()
    check, settings = definition.cross_check, _settings(scenario, budget)
    if seed is not None:
        settings = dataclasses.replace(settings, seed=seed)

    def execute(problem: Problem, checker: Estimator, settings: Settings) -> Result:
        name = problem.names[0]
        saved = journal(f"{name}{_CHECK}") if journal is not None else None
        executor = start_executor()
        with watch(f"{name}{note}  cross-check by {checker.name}", problem) as progress:
            return run(problem, checker, executor, settings, progress, saved, stop)[0]

    results = []
    for group in [(name,) for name in specifications] if estimator.single else [tuple(specifications)]:
        problem = scenario.problem(group)
        label = group[0] if len(group) == 1 else f"{definition.name} ({len(group)} specifications)"
        saved = journal(group[0]) if journal is not None else None
        executor = start_executor()
        with watch(f"{label}{note}  {estimator.name}", problem) as progress:
            found = run(problem, estimator, executor, settings, progress, saved, stop)
        for name, result in zip(group, found, strict=True):
            if check is not None:
                alone = problem if len(group) == 1 else scenario.problem(name)
                parts = count_sharers(result, len(group))
                result = add_cross_check(alone, result, check, settings, execute, parts=parts)
            results.append(result)
    if not definition.members:
        return results
    return include_model(
        scenario,
        results,
        _member_runner(scenario, budget, start_executor, watch, settings.seed, journal, stop),
    )


def _member_runner(
    scenario: LoadedScenario,
    budget: Budget | None,
    start_executor: Callable[[], Executor],
    watch: Watch,
    seed: int,
    journal: Callable[[str], Journal] | None,
    stop: Callable[[], bool] | None,
) -> Callable[[int, str], Result]:
    """Return a function that estimates a specification under a member; all of them share the budget anew."""
    members = scenario.definition.members
    paid = None if budget is None else dataclasses.replace(budget, amount=budget.amount / len(members))

    def run_member(number: int, name: str) -> Result:
        own = np.random.SeedSequence(seed, spawn_key=(_MEMBER_KEY, number)).generate_state(1, np.uint64)[0]
        saved = None if journal is None else lambda first: journal(f"{first}+model{number}")
        return estimate_specifications(
            LoadedScenario(members[number]),
            [name],
            paid,
            start_executor,
            watch,
            seed=int(own),
            note=f"  model {number + 1} of {len(members)}",
            journal=saved,
            stop=stop,
        )[0]

    return run_member
