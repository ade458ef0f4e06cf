"""How many independent runs a budget pays for."""

from __future__ import annotations

from avrare.errors import UsageError
from avrare.estimation.plan import Plan


def affordable_runs(plan: Plan, runs: int, method: str, rollouts: int, stages: float, of_what: str) -> int:
    """Runs that the budget pays for, at the cost of a run that goes down to 1e-4.

    The true cost shows only afterwards; to stop by it would drop runs because of what they found.

    Args:
        plan: With the budget.
        runs: Without one.
        method: For the message.
        rollouts: Of a run.
        stages: Steps of a run, in full rollouts.
        of_what: For the message: the option to lower, with its value.

    Raises:
        UsageError: It is a budget of seconds, or does not pay for one run.
    """
    budget = plan.budget
    if budget is None:
        return runs
    if budget.kind == "seconds":
        raise UsageError(
            f"{method} cannot be stopped by the clock: a run that has started must finish",
            "give the budget as steps=N or rollouts=N",
        )
    cost = round(stages * max(plan.steps, 1)) if budget.kind == "steps" else rollouts
    if budget.amount < cost:
        raise UsageError(
            f"a budget of {budget.kind}={budget.amount:g} does not pay for one run of {of_what}",
            f"raise it to {cost} or lower the {of_what.split()[-1]}",
        )
    return int(budget.amount // cost)
