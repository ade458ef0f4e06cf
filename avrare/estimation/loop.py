"""The estimation loop: ask, run, tell. The core owns the clock, the executor and the progress line."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from avrare.errors import UsageError, did_you_mean
from avrare.estimation.budget import Budget
from avrare.estimation.checks import examined
from avrare.estimation.health import check_names
from avrare.estimation.plan import Estimator, Info, Plan
from avrare.estimation.result import Result
from avrare.execute.work import Executor, Work
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request, Rollouts

Progress = Callable[[Info], None]
DEFAULT_MAX_ERROR_RATE = 0.01
_ARGUMENTS = ("seed", "workers", "confidence", "budget", "suppress")
"""What ``avrare.estimate`` takes beside the options: for the hint on a misspelt one."""


@dataclass(frozen=True)
class Settings:
    """What every estimator has in common.

    Attributes:
        seed: Of all random numbers.
        confidence: Of the intervals.
        budget: Upper bound on cost.
        max_error_rate: Share of broken rollouts above which a result is unhealthy.
        suppress: Names of health warnings to leave out.
        replay: Drive the least robust rollout once more to see that it comes out the same; beyond the cost.
    """

    seed: int = 0
    confidence: float = 0.95
    budget: Budget | None = None
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    suppress: tuple[str, ...] = ()
    replay: bool = False


def run(
    problem: Problem, estimator: Estimator, executor: Executor, settings: Settings,
    progress: Progress | None = None,
) -> list[Result]:  # fmt: skip
    """Estimate the failure probability of every specification of ``problem``.

    An estimator with ``prepare(problem) -> problem`` may put another problem in its place.

    Raises:
        UsageError: The estimator takes one specification and the problem has several.
    """
    if not (isinstance(settings.confidence, (int, float)) and 0.0 < settings.confidence < 1.0):
        raise UsageError(f"confidence must lie between 0 and 1, not {settings.confidence!r}")
    check_names(settings.suppress)
    if estimator.single and len(problem.names) > 1:
        raise UsageError(
            f"{estimator.name} estimates one specification at a time, not {', '.join(problem.names)}"
        )
    given, prepare = problem, getattr(estimator, "prepare", None)
    if prepare is not None:
        problem = prepare(given)
    noise = NoiseSource(settings.seed, problem.noise_size)
    plan = Plan(
        problem.names, problem.steps, problem.chunk, noise, settings.confidence, settings.budget,
        settings.max_error_rate,
    )  # fmt: skip
    began = time.perf_counter()
    executor.open(Work(problem, noise, scored=estimator.single))
    with closing(executor):
        state = _drive(estimator, plan, executor, progress or (lambda info: None), began)
    seconds = time.perf_counter() - began
    # Else its tapes may be those of another system, or its robustness that of a part of the run.
    replayed = settings.replay and problem is given and not getattr(estimator, "stops_early", False)
    results = [
        examined(problem, result, column, replay=replayed, suppress=settings.suppress)
        for column, result in enumerate(estimator.estimate(state))
    ]
    return [replace(result, seconds=seconds) for result in results]


def _drive(estimator: Estimator, plan: Plan, executor: Executor, progress: Progress, began: float) -> Any:
    state, info = estimator.init(plan)
    while not _out_of_time(plan, began, info) and (request := estimator.ask(state)) is not None:
        parts, so_far = [], info
        for part in _chunks(executor, request, plan.chunk):
            parts.append(part)
            so_far = so_far.plus(part)
            progress(so_far)
        state, info = estimator.tell(state, Rollouts.join(parts))
        progress(info)
    return state


def _chunks(executor: Executor, request: Request, size: int) -> Iterator[Rollouts]:
    return executor.map([request.slice(at, at + size) for at in range(0, request.rows, size)])


def _out_of_time(plan: Plan, began: float, info: Info) -> bool:
    """Whether a budget of seconds (Monte Carlo only) is spent; never before the first rollouts are in."""
    budget = plan.budget
    if budget is None or budget.kind != "seconds" or not info.rollouts:
        return False
    return time.perf_counter() - began >= budget.amount


def checked_options(config: type[Any], name: str, options: dict[str, Any]) -> Any:
    """Options of an estimator called from Python.

    Raises:
        UsageError: Unknown or invalid options, all of them named.
    """
    try:
        return config(**options)
    except ValidationError as error:
        problems, hints = [], []
        for entry in error.errors():
            option = ".".join(str(part) for part in entry["loc"])
            if entry["type"] == "extra_forbidden":
                problems.append(f"unknown option {option!r} of estimator {name!r}")
                hints.append(did_you_mean(option, [*config.model_fields, *_ARGUMENTS]))
            elif option:
                problems.append(
                    f"option {option!r} of estimator {name!r}: {entry['msg']}, found {entry['input']!r}"
                )
            else:
                problems.append(f"estimator {name!r}: {entry['msg'].removeprefix('Value error, ')}")
        raise UsageError("; ".join(problems), "; ".join(filter(None, hints)) or None) from None
