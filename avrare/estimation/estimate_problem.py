"""The public function ``avrare.estimate``, and the estimates of a scenario's specifications."""

from __future__ import annotations

import dataclasses
import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from avrare.base import version
from avrare.base.errors import HealthWarning, UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.checkpoint import Checkpoint
from avrare.estimation.loop import Progress, Settings, check_system, prepare_problem, run
from avrare.estimation.plan import Estimator, Journal
from avrare.estimation.result import Result
from avrare.logic.formula import find_formula
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.work import Executor, build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
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
    **options: Any,
) -> Result:
    """Estimate the failure probability of ``problem``.

    Each health warning of the result is also given as a ``HealthWarning``.

    Args:
        problem: Problem with one specification.
        estimator: Name of an installed estimator: "mc", "ams", ...
        seed: The same seed gives the same bits, for any number of workers.
        workers: Number of processes.
        confidence: Level of the interval, in (0, 1).
        budget: "steps=1e6", {"rollouts": 1000}, ...; None: the estimator's own options decide.
        suppress: Names of health warnings to leave out of the result.
        checkpoint: Folder in which the outcome of every chunk (``Problem(chunk=...)``) is kept until the
            estimate is complete. After an interruption the same call resumes from there with the same bits,
            for any number of workers; a call that differs is refused.
        **options: The estimator's options, per run: ``rollouts``, ``particles``, ``discard``, ``runs``, ...

    Raises:
        UsageError: Arguments are unknown or invalid, the checkpoint belongs to another call, or the system
            breaks a rule that the estimator relies on, as by changing its state in place.
        PluginError: No installed plugin provides the estimator.
    """
    if not isinstance(problem, Problem):
        raise UsageError(
            f"estimate needs a Problem, not {type(problem).__name__}",
            "avrare.Problem(system, specification, steps), or avrare.load(path).problem(name)",
        )
    if len(problem.names) != 1:
        raise UsageError(
            f"the problem has {len(problem.names)} specifications; estimate one at a time",
            "make a Problem for each, or use `avrare run`",
        )
    settings = Settings(seed, confidence, Budget.parse(budget), suppress=tuple(suppress))
    built, executor = _estimator(estimator, options), build_executor(workers)
    if checkpoint is None:
        return _told(run(problem, built, executor, settings)[0])
    if not isinstance(checkpoint, (str, os.PathLike)):
        raise UsageError(f"checkpoint must be the path of a folder, not {checkpoint!r}")
    task = _task(problem, estimator, built, settings)
    with Checkpoint.open(Path(checkpoint), task).held() as saved:
        result = run(problem, built, executor, settings, journal=saved.journal(problem.names[0]))[0]
        saved.remove()
    return _told(result)


def _told(result: Result) -> Result:
    for name, message in result.health.items():
        warnings.warn(f"{result.specification}: {name}: {message}", HealthWarning, stacklevel=3)
    return result


_ARGUMENTS = ("seed", "workers", "confidence", "budget", "suppress", "checkpoint")
"""Arguments of ``estimate`` that are not options: suggested for a misspelt option."""


def _estimator(name: str, options: dict[str, Any]) -> Estimator:
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
            "system": type(problem.system).__qualname__, "steps": problem.steps, "chunk": problem.chunk,
            "noise_size": problem.noise_size, "formula": formula.text if formula is not None else None,
            "score": getattr(problem.score, "text", problem.score),
        },
        "versions": {"avrare": version.__version__, row.distribution: row.version},
    }  # fmt: skip
    return json.loads(json.dumps(task, default=_plain))  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    return getattr(value, "__qualname__", type(value).__qualname__)


Watch = Callable[[str, Problem], AbstractContextManager[Progress | None]]
"""Called with a label and a problem as each estimate begins; gives its progress display."""


def check_scenario(scenario: LoadedScenario) -> dict[str, str]:
    """Return the health warnings on a scenario's system, found by a few steps; see ``check_system``."""
    definition, estimator = scenario.definition, scenario.estimator()
    problem = scenario.problem(definition.estimated[:1] if estimator.single else definition.estimated)
    return check_system(prepare_problem(estimator, problem), estimator)


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
    settings = Settings(
        definition.seed if seed is None else seed,
        definition.confidence,
        budget,
        definition.max_error_rate,
        definition.suppress,
    )
    results = []
    for group in [(name,) for name in specifications] if estimator.single else [tuple(specifications)]:
        problem = scenario.problem(group)
        label = group[0] if len(group) == 1 else f"{definition.name} ({len(group)} specifications)"
        saved = journal(group[0]) if journal is not None else None
        executor = start_executor()
        with watch(f"{label}{note}  {estimator.name}", problem) as progress:
            results += run(problem, estimator, executor, settings, progress, saved, stop)
    return results
