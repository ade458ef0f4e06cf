"""Pre-flight of an estimate: everything that speaks against it, before its first rollout."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from avrare.base.errors import UsageError
from avrare.base.health_messages import MESSAGES
from avrare.estimation.plan.memory import Forecast, forecast, measure_carry
from avrare.estimation.plan.plan import Estimator, Plan, Settings
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor, Work, run_on_worker
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.worlds.capabilities import STEPS, refuse_limits, require


@dataclass(frozen=True)
class Clearance:
    """Estimate that has passed all checks that are possible before the first rollout.

    Attributes:
        problem: Problem to estimate.
        estimator: Estimator of its specifications.
        settings: Settings of the estimate.
        work: Work of its executor, with the problem that the estimator puts in the place of ``problem``.
        plan: Task of the estimator.
        warnings: Health warnings on the system, by name.
        memory: Memory that the estimate needs.
    """

    problem: Problem
    estimator: Estimator
    settings: Settings
    work: Work
    plan: Plan
    warnings: dict[str, str]
    memory: Forecast


@contextmanager
def clear_estimate(
    problem: Problem, estimator: Estimator, settings: Settings, executor: Executor
) -> Iterator[Clearance]:
    """Yield the clearance of an estimate; its executor stays open until the block ends.

    Raises:
        UsageError: The estimate cannot begin.
    """
    prepared, plan = build_plan(problem, estimator, settings)
    work = Work(prepared, plan.noise, scored=estimator.single)
    executor.open(work)
    with closing(executor):
        warnings, carry = _probe_system(prepared, estimator, executor)
        memory = forecast(estimator, plan, carry)
        estimator.init(plan)  # refuses a budget that does not pay for it
        yield Clearance(problem, estimator, settings, work, plan, warnings, memory)


def check_estimate(problem: Problem, estimator: Estimator, settings: Settings) -> Clearance:
    """Return the clearance of an estimate that begins later.

    Raises:
        UsageError: The estimate could not begin.
    """
    with clear_estimate(problem, estimator, settings, SerialExecutor()) as clearance:
        return clearance


def build_plan(problem: Problem, estimator: Estimator, settings: Settings) -> tuple[Problem, Plan]:
    """Prepare the problem and the plan; run nothing."""
    if not (isinstance(settings.confidence, (int, float)) and 0.0 < settings.confidence < 1.0):
        raise UsageError(f"confidence must lie between 0 and 1, not {settings.confidence!r}")
    others = [name for name in settings.suppress if name not in problem.system.warnings]
    default_registry().check_suppressed(others)
    if estimator.single and len(problem.names) > 1:
        raise UsageError(
            f"{estimator.name} estimates one specification at a time, not {', '.join(problem.names)}"
        )
    refuse_limits(estimator.name, problem.system.lacks or {}, estimator.needs)
    problem = estimator.prepare(problem)
    noise = NoiseSource(settings.seed, problem.noise_size)
    plan = Plan(
        problem.names,
        problem.steps,
        problem.chunk,
        noise,
        settings.confidence,
        settings.budget,
        settings.max_error_rate,
        settings.seen,
    )
    return problem, plan


def check_system(problem: Problem, estimator: Estimator, settings: Settings) -> None:
    """Raise a ``UsageError`` if an estimator, at whatever size, cannot run a problem's system."""
    prepared, plan = build_plan(problem, estimator, settings)
    executor = SerialExecutor()
    executor.open(Work(prepared, plan.noise, scored=False))
    with closing(executor):
        _probe_system(prepared, estimator, executor)


def _probe_system(problem: Problem, estimator: Estimator, executor: Executor) -> tuple[dict[str, str], int]:
    """Return the health warnings on a system, and the bytes of a particle's carry, from a few steps."""
    name, needs = estimator.name, estimator.needs
    reasons, carry = run_on_worker(executor, "the probe before the estimate", _probe, name, needs)
    return {name: MESSAGES[name].format(reason=reason) for name, reason in reasons.items()}, carry


def _probe(problem: Problem, estimator: str, needs: tuple[str, ...]) -> tuple[dict[str, str], int]:
    reasons = require(problem.system, estimator, needs, min(STEPS, problem.steps))
    return reasons, measure_carry(problem)
