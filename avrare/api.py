"""The public functions: estimate a problem, load a scenario."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.errors import UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.loop import Settings, checked_options, run
from avrare.estimation.plan import Estimator
from avrare.estimation.result import Result
from avrare.execute.processes import ProcessExecutor
from avrare.execute.serial import SerialExecutor
from avrare.execute.work import Executor
from avrare.record.checkpoint import Checkpoint
from avrare.record.checkpoint_call import described
from avrare.rollout.problem import Problem

if TYPE_CHECKING:
    from avrare.build.scenario import BuildableScenario


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
    """Estimate how likely ``problem`` is to fail.

    Args:
        problem: With one specification.
        estimator: Name of an installed estimator: "mc", "ams", ...
        seed: The same seed gives the same bits, for any number of workers.
        workers: Processes.
        confidence: Of the interval.
        budget: "steps=1e6", {"rollouts": 1000}, ...; None: the estimator's own options decide.
        suppress: Names of health warnings to leave out of the result.
        checkpoint: A folder in which the outcome of every chunk (``Problem(chunk=...)``) is kept until the
            estimate is done. The same call goes on from there after an interruption, with the same bits, for
            any number of workers; a call that differs is refused.
        **options: The estimator's options, per run: ``rollouts``, ``particles``, ``discard``, ``runs``, ...

    Raises:
        UsageError: Unknown or invalid arguments, or the checkpoint is of another call.
        PluginError: Nobody provides the estimator.
    """
    if not isinstance(problem, Problem):
        raise UsageError(
            f"estimate needs a Problem, not {type(problem).__name__}",
            "avrare.Problem(system, specification, steps), or avrare.load(path).problem(name)",
        )
    if len(problem.names) != 1:
        raise UsageError(
            f"this problem has {len(problem.names)} specifications; estimate one at a time",
            "make a Problem for each, or use `avrare run`",
        )
    settings = Settings(seed, confidence, Budget.parse(budget), suppress=tuple(suppress))
    built, executor = _estimator(estimator, options), _executor(workers)
    if checkpoint is None:
        return run(problem, built, executor, settings)[0]
    if not isinstance(checkpoint, (str, os.PathLike)):
        raise UsageError(f"checkpoint is the path of a folder, not {checkpoint!r}")
    task = described(problem, estimator, built, settings)
    with Checkpoint.open(Path(checkpoint), task).held() as saved:
        result = run(problem, built, executor, settings, journal=saved.journal(problem.names[0]))[0]
        saved.remove()
    return result


def load(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> BuildableScenario:
    """Read and check a scenario file; ``.problem(name)`` builds the stack.

    Args:
        path: YAML file.
        overrides: As ``--set`` takes them, for example ``["steps=20", "estimator.particles=50"]``.

    Raises:
        ScenarioError: With every problem of the file at its line and column.
    """
    from avrare.build.scenario import BuildableScenario
    from avrare.scenario.load import load as read

    return BuildableScenario(read(path, overrides))


def _estimator(name: str, options: dict[str, Any]) -> Estimator:
    from avrare.plugin.registry import default_registry

    component = default_registry().get("estimator", name)
    config = checked_options(component.load_config(), name, options)
    return component.load_factory()(config, None)  # type: ignore[no-any-return]


def _executor(workers: int) -> Executor:
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise UsageError(f"workers must be an integer of at least 1, not {workers!r}")
    return SerialExecutor() if workers == 1 else ProcessExecutor(workers)
