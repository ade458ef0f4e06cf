"""Number of runs and rollouts that a budget pays for."""

from __future__ import annotations

import math

from avrare.base.errors import UsageError
from avrare.base.number_format import format_count
from avrare.estimation.plan.plan import Plan


def affordable_runs(plan: Plan, runs: int, method: str, rollouts: int, stages: float, size: str) -> int:
    """Return the number of runs that the budget pays for, at the cost of a run that goes down to 1e-4.

    The true cost is known only afterwards; stopping by it would drop runs because of their findings.

    Args:
        plan: Task with the budget.
        runs: Number of runs without a budget.
        method: Name of the method, for the message.
        rollouts: Rollouts of one run.
        stages: Steps of one run, in full rollouts.
        size: Value and name of the option to lower, for the message.

    Raises:
        UsageError: The budget is one of seconds, or does not pay for one run.
    """
    budget = plan.budget
    if budget is None:
        return runs
    if budget.kind == "seconds":
        raise _needs_known_cost(method, "run")
    paid = paid_runs(plan, rollouts, stages)
    if not paid:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for one run of {size}",
            f"raise it to {_cost(plan, rollouts, stages)} or lower the {size.split()[-1]}",
        )
    return paid


def paid_runs(plan: Plan, rollouts: int, stages: float) -> int:
    """Return the number of runs that the plan's budget pays for, maybe 0."""
    assert plan.budget is not None
    return int(plan.budget.amount // _cost(plan, rollouts, stages))


def _cost(plan: Plan, rollouts: int, stages: float) -> int:
    assert plan.budget is not None
    return round(stages * max(plan.steps, 1)) if plan.budget.kind == "steps" else rollouts


def affordable_rollouts(plan: Plan, rollouts: int, runs: int, stages: int, check: float = 0.0) -> int:
    """Return the rollouts of a stage that the budget pays for if all runs need all stages.

    Args:
        plan: Task with the budget.
        rollouts: Rollouts of a stage without a budget.
        runs: Number of runs.
        stages: Largest number of stages of a run.
        check: Share of the budget that the stages must leave.

    Raises:
        UsageError: The budget is one of seconds, or pays for too few rollouts.
    """
    budget = plan.budget
    if budget is None:
        return rollouts
    if budget.kind == "seconds":
        raise _needs_known_cost("weighted samples", "stage")
    cost = (max(plan.steps, 1) if budget.kind == "steps" else 1) * runs * stages
    paid = int((1.0 - check) * budget.amount // cost)
    least = 2 if stages == 1 else 20
    if paid < least:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for {format_count(runs, 'run')} of "
            f"{format_count(stages, 'stage')} of {least} rollouts",
            f"raise it to {math.ceil(least * cost / (1.0 - check))}",
        )
    return paid


def _needs_known_cost(method: str, unit: str) -> UsageError:
    return UsageError(
        f"{method} cannot be stopped by the clock: a {unit} that has started must finish",
        "give the budget as steps=N or rollouts=N",
    )
