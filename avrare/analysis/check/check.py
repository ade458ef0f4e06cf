"""Check of scenario files: thresholds and baselines, turned into verdicts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from avrare.analysis.check.gate import CheckResult, check_targets
from avrare.analysis.check.next_steps import with_next_steps
from avrare.analysis.check.targets import load_scenarios, load_targets, plan_looks
from avrare.base.errors import UsageError
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.plan.budget import Budget
from avrare.rollout.executors.work import build_executor
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode


def check(
    *scenarios: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    estimator: str | None = None,
    budget: Budget | Mapping[str, float] | str | None = None,
    spend: Budget | Mapping[str, float] | str | None = None,
    baseline: str | os.PathLike[str] | None = None,
    save: bool = False,
    require_baseline: bool = False,
    accept_changes: bool = False,
    strict: bool = False,
    workers: int = 1,
    executor: str | None = None,
    watch: Watch | None = None,
    safe: bool = False,
) -> CheckResult:
    """Compare the estimates of scenarios with their thresholds and baselines.

    Args:
        scenarios: YAML files; their criteria share one error rate.
        overrides: Settings as for ``--set``.
        estimator: Name of another estimator, with its default options.
        budget: Budget of each estimate, as for ``avrare.estimate``.
        spend: Largest budget, spent in up to four looks until every verdict is decided.
        baseline: Baseline folder, with a folder for each of several scenarios; None: beside each scenario.
        save: Save the results as new baselines.
        require_baseline: Refuse a scenario without a baseline.
        accept_changes: Compare even if a scenario has changed since its baseline.
        strict: A threshold that holds only as far as the search could see gives exit code 3.
        workers: Number of processes; changes no bit of a result.
        executor: Executor with its options, as for ``--executor``.
        watch: Progress display.
        safe: As for ``avrare.load``.

    Raises:
        ScenarioError: A file has mistakes.
        UsageError: The arguments do not fit, or a baseline is not comparable.
    """
    if not scenarios:
        raise UsageError("there is no scenario to check", 'avrare.check("scenario.yaml")')
    paid, spent = Budget.parse(budget), Budget.parse(spend)
    if paid and spent:
        raise UsageError("budget cannot be combined with spend", "remove one of them")
    with safe_mode(safe):
        targets = load_targets(
            load_scenarios(scenarios, as_settings(overrides), estimator),
            baseline,
            save=save,
            require=require_baseline,
            accept=accept_changes,
        )
    start_executor = partial(build_executor, workers, executor)
    execution = Execution(start_executor, watch or show_nothing)
    outcome = check_targets(targets, plan_looks(paid, spent), execution, save)
    return replace(with_next_steps(outcome, targets, None), strict=strict)
