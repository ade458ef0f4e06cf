"""Targets of a check, scenarios with their baselines and criteria, and the looks that estimate them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from avrare.analysis.check.baseline_files import (
    SHARED_KEYS,
    Baseline,
    default_folder,
    find_differences,
    read_newest,
    summarise_differences,
)
from avrare.analysis.check.criteria import Criterion
from avrare.analysis.check.pooling import SHARES
from avrare.analysis.check.power_analysis import (
    BASELINE_SHARE,
    AutoLimits,
    describe_coarse_baseline,
    find_spread,
    find_variance,
)
from avrare.base.errors import UsageError
from avrare.estimation.choice.auto_config import AutoConfig
from avrare.estimation.choice.auto_rules import GOAL, ROLLOUTS
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.estimate import estimate_scenario
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.fingerprint import changed_files, digests
from avrare.scenario.safe_mode import refuse_outside
from avrare.scenario.schema import Regression, Scenario


@dataclass(frozen=True)
class CheckTarget:
    """Scenario under check."""

    scenario: LoadedScenario
    folder: Path  # of its baselines
    compared: bool  # with a baseline, if there is one
    baseline: Baseline | None  # the newest one
    notes: tuple[str, ...] = ()  # on the comparison
    restarts: bool = False  # the line of baselines starts anew: none is compared with its first

    @property
    def definition(self) -> Scenario:
        """Definition of the scenario."""
        return self.scenario.definition

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.definition.name

    @property
    def criteria(self) -> list[Criterion]:
        """Thresholds, then comparisons with the baseline and with the first of its line."""
        definition = self.definition
        criteria = [
            Criterion(self.name, threshold.specification, threshold) for threshold in definition.thresholds
        ]
        if self.baseline is None:
            return criteria
        firsts = {} if self.restarts else self.baseline.firsts
        for name in definition.estimated:
            for reference, entries in (("baseline", self.baseline.entries), ("first baseline", firsts)):
                if (entry := entries.get(name)) is not None:
                    health = {k: text for k, text in entry.health.items() if k not in definition.suppress}
                    before = replace(entry, health=health)
                    criteria.append(Criterion(self.name, name, self._regression, before, reference))
        return criteria

    @property
    def firsts(self) -> Mapping[str, Result]:
        """First baseline of each specification's line, for the next one; one with warnings begins none."""
        if self.baseline is None or self.restarts:
            return {}
        healthy = {name: entry for name, entry in self.baseline.entries.items() if not entry.health}
        return {**healthy, **self.baseline.firsts}

    @property
    def is_by_auto(self) -> bool:
        """True where the estimator chooses among others, and its own size."""
        return isinstance(self.definition.estimator.config, AutoConfig)

    @property
    def planned_criteria(self) -> list[Criterion]:
        """Criteria, and those that a first baseline will add."""
        if not self.compared or self.baseline is not None:
            return self.criteria
        added = [Criterion(self.name, name, self._regression) for name in self.definition.estimated]
        return self.criteria + added

    def find_goal(self, save: bool) -> float | None:
        """Return the relative error that decides the comparisons with a baseline; None where none is made."""
        if not self.compared:
            return None
        variance = find_variance(self._regression)
        used = 1.0 - BASELINE_SHARE
        if self.baseline is not None and not save:
            errors = [find_spread(entry) for entry in self.baseline.entries.values()]
            used = min(
                used, max((error**2 for error in errors if math.isfinite(error)), default=0.0) / variance
            )
        return min(GOAL, round(math.sqrt((1.0 - used) * variance), 3))

    def find_limits(self) -> AutoLimits | None:
        """Return where ``auto`` ends, for a first baseline where there is none; None for other estimators."""
        config = self.definition.estimator.config
        if not isinstance(config, AutoConfig):
            return None
        goal = config.relative_error
        if goal is None and config.rollouts is None:
            goal = self.find_goal(save=False) or GOAL
        return AutoLimits(config.rollouts or ROLLOUTS, goal)

    def describe_coarse(self, results: Sequence[Result]) -> list[str]:
        """Return a line for each result that is too imprecise for a baseline, with the reason."""
        reasons = {each.specification: describe_coarse_baseline(self._regression, each) for each in results}
        return [f"{self.name} {name}: {reason}" for name, reason in reasons.items() if reason]

    @property
    def _regression(self) -> Regression:
        return self.definition.regression or Regression.model_validate({})


def load_target(definition: Scenario, folder: Path, compared: bool, accept: bool) -> CheckTarget:
    """Pair a scenario with its newest baseline, if it is to be ``compared``.

    UsageError if the baseline cannot be read, or is of another problem and ``accept`` is False.
    """
    baseline = read_newest(folder) if compared else None
    scenario = LoadedScenario(definition)
    if baseline is None:
        return CheckTarget(scenario, folder, compared, None)
    files = digests(definition)
    unmoved = baseline.files.keys() & files.keys()  # compared by what they hold, wherever they lie
    changes = [
        line
        for line in find_differences(baseline.scenario, definition.resolved, list(baseline.entries))
        if line.partition(" ")[0] not in unmoved
    ]
    keys = (*SHARED_KEYS, *(f"specifications.{name}" for name in baseline.entries))
    changes += changed_files(baseline.files, files, keys)
    if changes and not accept:
        raise UsageError(
            f"{definition.path}: not comparable with {baseline.path}: {summarise_differences(changes)}",
            "undo the change; or compare anyway with --accept-changes, and --save a new baseline with it",
        )
    notes = [f"compared although the problem changed: {summarise_differences(changes)}"] if changes else []
    versions = [
        f"{name} {baseline.versions.get(name, 'none')} -> {version}"
        for name, version in definition.versions.items()
        if baseline.versions.get(name) != version
    ]
    notes += [f"the baseline was made with other versions: {', '.join(versions)}"] if versions else []
    removed = [name for name in baseline.entries if name not in definition.estimated]
    notes += [f"no longer estimated: {', '.join(removed)}"] if removed else []
    return CheckTarget(scenario, folder, compared, baseline, tuple(notes), restarts=accept)


def load_targets(
    scenarios: Sequence[Scenario],
    baseline: str | os.PathLike[str] | None = None,
    *,
    save: bool = False,
    require: bool = False,
    accept: bool = False,
) -> list[CheckTarget]:
    """Pair each scenario with its newest baseline, where it is to be compared with one.

    Args:
        scenarios: The scenarios.
        baseline: Baseline folder, with a folder for each of several scenarios; None: beside each scenario.
        save: The results become the new baselines.
        require: A scenario without a baseline is refused.
        accept: A baseline of another problem is accepted.

    Raises:
        UsageError: A baseline cannot be read, does not fit, or is missing.
    """
    targets = []
    for scenario in scenarios:
        folder = default_folder(scenario) if baseline is None else Path(baseline)
        if baseline is None:
            refuse_outside(folder, Path(scenario.path).parent, "the baseline folder")
        if baseline is not None and len(scenarios) > 1:
            folder /= scenario.name
        requested = baseline is not None or save or scenario.regression is not None
        compared = requested or require or not scenario.thresholds or folder.is_dir()
        targets.append(load_target(scenario, folder, compared, accept))
        if require and targets[-1].baseline is None:
            text = f"{folder}: there is no baseline of {scenario.name!r}"
            raise UsageError(text, "check the folder, or save a baseline and commit it")
    return targets


@dataclass(frozen=True)
class Look:
    """Interim look and the batch that is drawn for it."""

    number: int  # from 1
    share: float  # of the error rate
    budget: Budget | None  # of each estimate; None: the estimator's own options decide

    def seed(self, seed: int) -> int:
        """Return the seed of this look, so that the batches of all looks are independent."""
        stride = 0x9E3779B97F4A7C15
        return (seed + (self.number - 1) * stride) % 2**63


def plan_looks(budget: Budget | None, several: bool = False) -> list[Look]:
    """Return the only look, or several that share the budget.

    Raises:
        UsageError: A budget to share is missing.
    """
    if not several:
        return [Look(1, 1.0, budget)]
    if budget is None:
        raise UsageError("several looks need a budget to share", "add a budget, for example rollouts=8000")
    return [
        Look(number, share, Budget(budget.kind, budget.amount * share))
        for number, share in enumerate(SHARES, 1)
    ]


def plan_check(
    targets: Sequence[CheckTarget], budget: Budget | None, several: bool = False, save: bool = False
) -> list[Look]:
    """Return the looks of a check: two where its size is left to ``auto`` and it compares with baselines.

    A doubt may widen an estimate, and another with noise of its own mostly decides what that leaves open.

    Raises:
        UsageError: Several looks need a budget to share.
    """
    sized = budget is not None or several or save
    if sized or not all(target.baseline is not None and target.is_by_auto for target in targets):
        return plan_looks(budget, several)
    return [Look(1, 0.5, None), Look(2, 0.5, None)]


def estimate_look(
    scenario: LoadedScenario,
    specifications: Sequence[str],
    look: Look,
    execution: Execution,
    goal: float | None = None,
) -> list[Result]:
    """Estimate specifications of a scenario for one look; UsageError if the estimator cannot.

    ``goal`` is the relative error for ``auto``; None: its own.
    """
    note = f"  look {look.number}" if look.share < 1.0 else ""
    folder = f"{scenario.name}/look-{look.number}"
    results = estimate_scenario(
        scenario,
        specifications,
        look.budget,
        replace(execution, journal=lambda name: execution.journal(f"{folder}/{name}")),
        seed=look.seed(scenario.definition.seed),
        note=note,
        goal=goal,
    )
    # Rounding says nothing against an estimate: it must not make a check inconclusive.
    return [
        replace(result, health={k: text for k, text in result.health.items() if k != "rounding"})
        for result in results
    ]
