"""What would stop a later scenario of a command is told before the first one takes its time."""

from __future__ import annotations

from typing import Any

from avrare.errors import UsageError


def refuse_what_cannot_begin(scenario: Any, budget: Any) -> None:
    """Build a scenario's stack and begin its estimate; nothing is driven.

    Args:
        scenario: ``avrare.build.scenario.BuildableScenario``; what is built stays with it.
        budget: Of each estimate, or None.

    Raises:
        UsageError: The estimator cannot take the problem, or the budget does not pay for one of its runs.
        AvrareError: The stack cannot be built.
    """
    from avrare.estimation.loop import Settings, planned

    definition, estimator = scenario.definition, scenario.estimator()
    problem = scenario.problem(definition.estimated[:1] if estimator.single else definition.estimated)
    settings = Settings(
        definition.seed, definition.confidence, budget, definition.max_error_rate, definition.suppress
    )
    try:
        estimator.init(planned(problem, estimator, settings)[1])
    except UsageError as error:
        raise UsageError(f"{definition.name}: {error.message}", error.hint) from None
