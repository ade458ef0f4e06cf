"""A scenario with the baseline that it is compared with: what is asked of it, and how it is estimated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from avrare.build.scenario import BuildableScenario
from avrare.check import question
from avrare.check.baseline import Baseline, newest
from avrare.check.claims import Claim
from avrare.check.looks import Stage
from avrare.errors import UsageError
from avrare.estimation.loop import Settings, run
from avrare.estimation.result import Result
from avrare.plugin.registry import default_registry
from avrare.rollout.problem import Problem
from avrare.scenario import files
from avrare.scenario.schema import Regression, Scenario

Watch = Callable[[str, Problem], AbstractContextManager[Any]]
"""Shows what begins: called with a label and the problem, gives the progress of that estimate."""


@dataclass(frozen=True)
class Subject:
    """A scenario to check.

    Attributes:
        scenario: With its stack.
        folder: Of its baselines.
        compared: Whether it is compared with one at all.
        baseline: The newest; None where none is saved yet.
        notes: What to know of the comparison.
    """

    scenario: BuildableScenario
    folder: Path
    compared: bool
    baseline: Baseline | None
    notes: tuple[str, ...] = ()

    @property
    def definition(self) -> Scenario:
        """The checked scenario."""
        return self.scenario.definition

    @property
    def claims(self) -> list[Claim]:
        """Its thresholds, then its rules against the baseline."""
        definition, name = self.definition, self.definition.name
        found = [Claim(name, one.specification, one) for one in definition.thresholds]
        entries = self.baseline.entries if self.baseline is not None else {}
        for rule in definition.estimated:
            if rule in entries:
                warned = tuple(one for one in entries[rule].health if one not in definition.suppress)
                criterion = definition.regression or Regression.model_validate({})
                found.append(Claim(name, rule, criterion, replace(entries[rule], health=warned)))
        return found

    @property
    def planned(self) -> list[Claim]:
        """The claims, and those that there will be once a baseline is saved."""
        claims, definition = self.claims, self.definition
        if not self.compared or self.baseline is not None:
            return claims
        criterion = definition.regression or Regression.model_validate({})
        return claims + [Claim(definition.name, rule, criterion) for rule in definition.estimated]


def subject(definition: Scenario, folder: Path, compared: bool, accept: bool) -> Subject:
    """The scenario with its newest baseline.

    Args:
        definition: The scenario.
        folder: Of its baselines.
        compared: Whether to look for one.
        accept: Compare even with the answer to another question.

    Raises:
        UsageError: The baseline cannot be read, or answers another question.
    """
    baseline = newest(folder) if compared else None
    scenario = BuildableScenario(definition)
    if baseline is None:
        return Subject(scenario, folder, compared, None)
    old, new = baseline.scenario, definition.resolved
    asked = (*question.SHARED, *(f"specifications.{rule}" for rule in baseline.entries))
    changes = question.differences(old, new, list(baseline.entries))
    changes += files.changes(baseline.files, files.digests(definition), asked)
    if changes and not accept:
        raise UsageError(
            f"{definition.path}: {baseline.path} answers another question: {question.told(changes)}",
            "undo the change; or --accept-changes to compare all the same, with --save to make this run the "
            "new baseline",
        )
    notes = [f"compared although the question changed: {question.told(changes)}"] if changes else []
    others = [
        f"{name} {baseline.versions.get(name, 'none')} -> {version}"
        for name, version in definition.versions.items()
        if baseline.versions.get(name) != version
    ]
    notes += [f"the baseline was made with other versions: {', '.join(others)}"] if others else []
    gone = [rule for rule in baseline.entries if rule not in definition.estimated]
    notes += [f"no longer estimated: {', '.join(gone)}"] if gone else []
    return Subject(scenario, folder, compared, baseline, tuple(notes))


@dataclass(frozen=True)
class Machine:
    """Where estimates run.

    Attributes:
        workers: Processes.
        executor: Its name; None: serial, or processes for several workers.
        watch: Shows what begins.
    """

    workers: int
    executor: str | None
    watch: Watch

    def start(self) -> Any:
        """An executor."""
        name = self.executor or ("processes" if self.workers > 1 else "serial")
        component = default_registry().require("executor", name)
        return component.load_factory()(component.load_config()(workers=self.workers), None)


def estimate(
    scenario: BuildableScenario, rules: Sequence[str], stage: Stage, machine: Machine
) -> list[Result]:
    """Estimate some of a scenario's rules: in one pass where the estimator can, else one after the other.

    Raises:
        UsageError: The estimator cannot take the problem or the budget.
    """
    definition, estimator = scenario.definition, scenario.estimator()
    settings = Settings(
        stage.seed(definition.seed), definition.confidence, stage.budget, definition.max_error_rate,
        definition.suppress, replay=True,
    )  # fmt: skip
    results = []
    for group in [(rule,) for rule in rules] if estimator.single else [tuple(rules)]:
        problem = scenario.problem(group)
        label = group[0] if len(group) == 1 else f"{definition.name} ({len(group)} specifications)"
        label += f"  look {stage.number}" if stage.share < 1.0 else ""
        with machine.watch(f"{label}  {estimator.name}", problem) as progress:
            results += run(problem, estimator, machine.start(), settings, progress)
    return results
