"""Estimates of the specifications of a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.combine.cross_check import subtract_check
from avrare.estimation.combine.ensemble import include_model
from avrare.estimation.combine.specifications import Execution, check_specifications, estimate_specifications
from avrare.estimation.loop.preflight import Clearance
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.twin import check_twin

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
