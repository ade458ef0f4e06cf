"""What the estimators are compared on: one specification of a scenario, or a reference problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from avrare.build.scenario import BuildableScenario
from avrare.compare.truth import Truth
from avrare.errors import UsageError, did_you_mean
from avrare.estimation.loop import DEFAULT_MAX_ERROR_RATE
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Block, Scenario
from avrare.testing.problems import reference_problem

REFERENCE = "problem:"
"""What stands before the id of a reference problem."""


@dataclass(frozen=True)
class Case:
    """A problem with one specification.

    Attributes:
        name: Of the scenario, or the id of the reference problem.
        specification: Its name; empty for a reference problem.
        problem: What the estimators take.
        truth: Its failure probability, where it is known.
        scene: Of the driving simulator, if it is one.
        estimator: The scenario's own estimator block.
        seed: The scenario's.
        confidence: Of the intervals.
        max_error_rate: Share of broken rollouts above which a result is unhealthy.
        fingerprint: Of the scenario; None for a reference problem.
        versions: Of the distributions that the scenario uses.
    """

    name: str
    specification: str
    problem: Problem
    truth: Truth | None = None
    scene: object | None = None
    estimator: Block | None = None
    seed: int = 0
    confidence: float = 0.95
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    fingerprint: str | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name and, for a scenario, specification."""
        return f"{self.name}  {self.specification}" if self.specification else self.name


def reference_case(id: str) -> Case:
    """A reference problem with its exact answer.

    Raises:
        UsageError: There is none of that name.
    """
    try:
        reference = reference_problem(id)
    except UsageError as error:
        raise UsageError(error.message, error.hint or "avrare compare problem: lists them") from None
    return Case(id, "", reference.problem(), Truth(reference.probability, "exact"))


def scenario_case(path: str, specification: str | None, overrides: Sequence[str] = ()) -> Case:
    """One specification of a scenario.

    Args:
        path: The scenario's file.
        specification: Its name; None where the scenario estimates only one.
        overrides: ``KEY=VALUE`` settings of the scenario.

    Raises:
        ScenarioError: What is wrong with the file.
        UsageError: There is no such specification, or several and none was chosen.
    """
    definition = load(path, overrides)
    scenario = BuildableScenario(definition)
    name = _chosen(definition, specification)
    return Case(
        name=definition.name,
        specification=name,
        problem=scenario.problem(name),
        scene=scenario.scene,
        estimator=definition.estimator,
        seed=definition.seed,
        confidence=definition.confidence,
        max_error_rate=definition.max_error_rate,
        fingerprint=fingerprint(definition),
        versions=definition.versions,
    )


def _chosen(definition: Scenario, specification: str | None) -> str:
    known = definition.specifications
    if specification is not None:
        if specification not in known:
            raise UsageError(
                f"--specification: scenario {definition.name!r} has no specification {specification!r}",
                did_you_mean(specification, known),
            )
        return specification
    if len(definition.estimated) > 1:
        raise UsageError(
            f"scenario {definition.name!r} has {len(definition.estimated)} specifications: choose one",
            f"--specification {' | '.join(definition.estimated)}",
        )
    return definition.estimated[0]
