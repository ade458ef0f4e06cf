"""Work of an executor, the choice among executors, and checks of stored work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from pydantic import Field

from avrare import protocols
from avrare.base.errors import UsageError
from avrare.plugin import Options
from avrare.plugin.registry import default_registry
from avrare.rollout.child_process import run_here
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.overrides import override
from avrare.scenario.validation import check_options
from avrare.scenario.value_positions import Mark, Node

P = ParamSpec("P")
T = TypeVar("T")


class ExecutorConfig(Options):
    """Options of the core's executors."""

    workers: int = Field(default=1, ge=1, le=1024, description="processes")


@dataclass(frozen=True)
class FunctionCall:
    """Run of the system beside the chunks of an estimate.

    Attributes:
        purpose: The run in words, such as "the probe before the estimate".
        function: Function of the problem and of the arguments, at the top level of a module.
        arguments: The arguments.
    """

    purpose: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]

    def describe(self) -> str:
        """Return where a worker is that runs it."""
        return f"in {self.purpose}"


Task = Request | FunctionCall


@dataclass(frozen=True)
class Work:
    """Work that all chunks of an estimate share."""

    problem: Problem  # must survive pickling to reach another process
    noise: NoiseSource
    scored: bool  # True where the estimator needs the importance score

    def run(self, task: Task) -> Any:
        """Return the outcome of a chunk (``Rollouts``) or of a function call; the same wherever it runs."""
        run_here(self.problem.system)
        if isinstance(task, FunctionCall):
            return task.function(self.problem, *task.arguments)
        return self.problem.simulate(self.noise, task, scored=self.scored)


Executor = protocols.Executor[Work, Task, Any]
"""Executor of chunks of rollouts, and of other calls of the problem."""


def run_on_worker(
    executor: Executor,
    purpose: str,
    function: Callable[Concatenate[Problem, P], T],
    *arguments: P.args,
    **_: P.kwargs,
) -> T:
    """Return the result of ``function`` for the problem of an open executor, where that runs the system."""
    (answer,) = executor.map([FunctionCall(purpose, function, arguments)])
    return answer  # type: ignore[no-any-return]


def build_executor(workers: int, text: str | None = None) -> Executor:
    """Build an executor from ``NAME`` or ``NAME,OPTION=VALUE,...``, None: the simplest that fits."""
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise UsageError(f"workers must be an integer of at least 1, not {workers!r}")
    name, *settings = (text or ("processes" if workers > 1 else "serial")).split(",")
    component = default_registry().require("executor", name)
    mark = Mark("--executor")
    options: dict[str, Any] = override(Node({}, mark, mark), settings).plain()
    config = check_options(component.load_config(), name, {"workers": workers, **options}, "executor")
    return component.build(config)  # type: ignore[no-any-return]


def check_reproduces(run: Callable[[Request], Rollouts], chunk: Request, stored: Rollouts) -> None:
    """Run the least robust rollout of a stored chunk again; raise where it differs: the system has changed.

    Where it differs, the complete chunk is run, as rows of a system may depend on their neighbours.
    """
    row = int(np.argmin(np.where(stored.error, np.inf, stored.robustness.min(axis=1))))
    repeated = run(chunk.slice(row, row + 1))
    if not _difference(stored, row, repeated, 0):
        return
    repeated = run(chunk)
    difference = _difference(stored, row, repeated, row)
    if difference:
        raise UsageError(
            f"a saved rollout (run {chunk.run[row]}, stage {chunk.stage[row]}, particle "
            f"{chunk.particle[row]}) does not reproduce: {difference}",
            "the code or its libraries have changed since: restore them, or start again in another folder",
        )


def _difference(stored: Rollouts, row: int, repeated: Rollouts, other: int) -> str:
    # scores first: they give the step
    for name in ("scores", "robustness", "violated", "error", "log_weight"):
        before, after = getattr(stored, name)[row], getattr(repeated, name)[other]
        if not _same(before, after).all():
            return _describe_difference(name, before, after)
    for name in sorted({*stored.counts, *repeated.counts}):
        before, after = _count(stored, name, row), _count(repeated, name, other)
        if before != after:
            return f"{name} {before} -> {after}"
    return ""


def _same(before: Any, after: Any) -> Any:
    if np.shape(before) != np.shape(after):
        return np.zeros(1, dtype=bool)
    return (before == after) | ((before != before) & (after != after))  # NaN is NaN


def _count(outcome: Rollouts, name: str, row: int) -> int:
    return int(outcome.counts[name][row]) if name in outcome.counts else 0


def _describe_difference(name: str, before: Any, after: Any) -> str:
    if name == "scores" and before.shape == after.shape:
        step = int(np.flatnonzero(~_same(before, after))[0])
        return f"from step {step} on, score {before[step]:.17g} -> {after[step]:.17g}"
    return f"{name} {np.ravel(before).tolist()} -> {np.ravel(after).tolist()}"
