"""Case of a comparison: one specification of a scenario, or a reference problem, and its true probability."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from avrare.base.errors import UsageError, did_you_mean, require_path
from avrare.driving import Scene
from avrare.estimation.plan.plan import DEFAULT_MAX_ERROR_RATE
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario, open_problem
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Block, Scenario
from avrare.testing.problems import reference_problem

ENOUGH_FAILURES = 100
"""Failures that make a Monte Carlo estimate precise enough to compare with: a relative error of 10 %."""
POOLED = "pooled monte carlo"
"""Source of a truth that is computed from the repetitions of Monte Carlo."""


@dataclass(frozen=True)
class GroundTruth:
    """Failure probability in (0, 1)."""

    probability: float
    # "exact", "given", "monte carlo" (a long run of its own) or POOLED (the repetitions)
    source: str
    interval: Interval | None = None  # if the probability is estimated and not pooled
    failures: int | None = None  # that it rests on, if it is estimated

    @staticmethod
    def from_monte_carlo(result: Result) -> GroundTruth:
        """Return the truth that a long run found; UsageError if no rollout failed, or all of them did."""
        if not 0.0 < result.probability < 1.0:
            which = "no" if result.probability == 0.0 else "every"
            raise UsageError(
                f"truth: {which} rollout of {result.rollouts} failed, so the probability is not known",
                "give more rollouts, or leave the truth out",
            )
        return GroundTruth(result.probability, "monte carlo", result.interval, result.failures.count)


@dataclass(frozen=True)
class ComparisonCase:
    """Problem with one specification, and the settings that all estimators share."""

    name: str  # of the scenario, or id of the reference problem
    specification: str  # empty for a reference problem
    problem: Problem
    truth: GroundTruth | None = None
    scene: Scene | None = None  # of the driving simulator, if it is one
    estimator: Block | None = None  # the scenario's own
    seed: int = 0
    confidence: float = 0.95
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    fingerprint: str | None = None  # None for a reference problem
    versions: Mapping[str, str] = field(default_factory=dict)  # of the distributions that the scenario uses

    @property
    def title(self) -> str:
        """Name and, for a scenario, specification."""
        return f"{self.name}  {self.specification}" if self.specification else self.name


def open_case(
    subject: Problem | str | os.PathLike[str],
    specification: str | None,
    overrides: Sequence[str],
    truth: GroundTruth | int | None,
    safe: bool = False,
) -> ComparisonCase:
    """Return the case of a scenario file, a problem, or a reference problem ``problem:ID``.

    Args:
        subject: What to open.
        specification: Name; None: the only one.
        overrides: Settings of the scenario, as for ``--set``.
        truth: True probability, or the rollouts that are to estimate it.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: An argument does not fit, or the specification is missing or unknown.
    """
    truth_result = truth if isinstance(truth, GroundTruth) else None
    if isinstance(subject, Problem):
        problem = open_problem(subject, specification, overrides)
        return ComparisonCase(type(problem.system).__name__, problem.names[0], problem, truth_result)
    path = require_path(subject, "a scenario file or a Problem")
    prefix = "problem:"
    if not path.startswith(prefix):
        with safe_mode(safe):
            case = scenario_case(path, specification, overrides)
        return replace(case, truth=truth_result)
    for option, value in (
        ("truth", truth),
        ("specification", specification),
        ("setting scenario.KEY", overrides),
    ):
        if value:
            raise UsageError(
                f"{option} cannot be used with {path}",
                "a reference problem has one formula and a known probability",
            )
    return reference_case(path.removeprefix(prefix))


def reference_case(id: str) -> ComparisonCase:
    """Return a reference problem with its exact probability; UsageError if it does not exist."""
    try:
        reference = reference_problem(id)
    except UsageError as error:
        raise UsageError(error.message, error.hint or "avrare compare problem: lists them") from None
    return ComparisonCase(id, "", reference.problem(), GroundTruth(reference.probability, "exact"))


def scenario_case(path: str, specification: str | None, overrides: Sequence[str] = ()) -> ComparisonCase:
    """Return one specification of a scenario, which may be None if the scenario estimates only one.

    ScenarioError if the scenario is invalid, UsageError if the specification is missing or unknown.
    """
    definition = load(path, overrides)
    scenario = LoadedScenario(definition)
    name = _select(definition, specification)
    return ComparisonCase(
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


def parse_truth(text: str) -> GroundTruth | int:
    """Return the given probability (``1.2e-4``), or the rollouts that are to estimate it (``mc=1e6``)."""
    word, equals, amount = text.partition("=")
    try:
        value = float((amount if equals else word).replace("_", ""))
    except ValueError:
        value = -1.0
    if equals and word.strip() == "mc" and 1.0 <= value < 2**40 and value == int(value):
        return int(value)
    if not equals and 0.0 < value < 1.0:
        return GroundTruth(value, "given")
    raise UsageError(
        f"truth {text}: should be a probability between 0 and 1, or mc=ROLLOUTS",
        "for example 1.2e-4 or mc=1e6",
    )


def _select(definition: Scenario, specification: str | None) -> str:
    specifications = definition.specifications
    if specification is not None and specification not in specifications:
        raise UsageError(
            f"scenario {definition.name!r} has no specification {specification!r}",
            did_you_mean(specification, specifications),
        )
    if specification is None and len(definition.estimated) > 1:
        raise UsageError(
            f"scenario {definition.name!r} has {len(definition.estimated)} specifications: choose one",
            f"one of: {', '.join(definition.estimated)}",
        )
    return definition.estimated[0] if specification is None else specification
