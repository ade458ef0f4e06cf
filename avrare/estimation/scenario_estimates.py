"""Estimates of a scenario's specifications."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from avrare.estimation.budget import Budget
from avrare.estimation.loop import Progress, Settings, run
from avrare.estimation.plan import Journal
from avrare.estimation.result import Result
from avrare.rollout.executors.work import Executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem

Watch = Callable[[str, Problem], AbstractContextManager[Progress | None]]
"""Called with a label and a problem as each estimate begins; gives its progress display."""


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

    Args:
        scenario: The scenario; gives the estimator, the confidence and the allowed share of errors.
        specifications: Names of the specifications.
        budget: Upper bound on the cost of each estimate.
        start_executor: Makes the executor of one estimate.
        watch: Shows the progress.
        seed: Seed of all random numbers; None: the scenario's.
        note: Added to the label of each estimate.
        journal: Gives the journal of an estimate by its first specification.
        stop: Ends an estimate before its next chunk once it returns true.

    Raises:
        UsageError: The estimator cannot take the problem or the budget.
        Interrupted: ``stop`` returned true before the end.
    """
    definition, estimator = scenario.definition, scenario.estimator()
    settings = Settings(
        definition.seed if seed is None else seed,
        definition.confidence,
        budget,
        definition.max_error_rate,
        definition.suppress,
        replay=True,
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
