"""Check of scenario files: thresholds and baselines, turned into verdicts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult, check_targets
from avrare.analysis.check.next_steps import with_next_steps
from avrare.analysis.check.targets import load_targets, plan_check
from avrare.analysis.rates.catalogue import Catalogue, load_catalogue
from avrare.analysis.rates.rate import rate
from avrare.analysis.rates.rates import BROKEN, CatalogueRates
from avrare.base.errors import UsageError
from avrare.base.number_format import format_interval, format_probability
from avrare.estimation.combine.specifications import Execution, Watch, show_nothing
from avrare.estimation.plan.budget import Budget
from avrare.rollout.executors.work import build_executor
from avrare.scenario.load import is_catalogue, load_scenarios
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode


def check(
    *scenarios: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    estimator: str | None = None,
    budget: Budget | Mapping[str, float] | str | None = None,
    looks: bool = False,
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
    """Compare the estimates of scenarios, or the rates of a catalogue, with their thresholds and baselines.

    Args:
        scenarios: YAML files; their criteria share one error rate. A catalogue is checked alone, by its own
            thresholds: it takes ``budget``, ``strict``, ``workers``, ``executor``, ``watch`` and ``safe``.
        overrides: Settings as for ``--set``.
        estimator: Name of another estimator, with its default options.
        budget: Budget of each estimate, as for ``avrare.estimate``.
        looks: Spend the budget in up to four looks, until every verdict is decided.
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
    if any(map(is_catalogue, scenarios)):
        options = {"overrides": overrides, "estimator": estimator, "looks": looks, "baseline": baseline}
        flags = {"save": save, "require_baseline": require_baseline, "accept_changes": accept_changes}
        path = choose_catalogue(scenarios, **options, **flags).path
        rates = rate(path, budget=budget, workers=workers, executor=executor, watch=watch, safe=safe)
        return decide_rates(rates, strict)
    with safe_mode(safe):
        loaded = load_scenarios(scenarios, as_settings(overrides), estimator)
        targets = load_targets(loaded, baseline, save=save, require=require_baseline, accept=accept_changes)
    execution = Execution(partial(build_executor, workers, executor), watch or show_nothing)
    planned_looks = plan_check(targets, Budget.parse(budget), looks, save)
    outcome = check_targets(targets, planned_looks, execution, save)
    return replace(with_next_steps(outcome, targets, None), strict=strict)


def choose_catalogue(paths: Sequence[str | os.PathLike[str]], **options: object) -> Catalogue:
    """Return the only catalogue of ``paths``; ``options`` are of scenarios, and none of them may be set.

    Raises:
        UsageError: There are other files, an option is given, or it has no thresholds.
    """
    path = next(filter(is_catalogue, paths))
    if len(paths) > 1:
        raise UsageError(f"{path}: is a catalogue, which is checked alone", "check them one at a time")
    for name, value in options.items():
        if value is not None and value is not False and value not in ([], ()):  # a seed may be 0
            text = f"{name.replace('_', ' ')} is an option of scenarios, and {path} is a catalogue"
            hint = "change the catalogue; its rates are compared with its thresholds, and with no baseline"
            raise UsageError(text, hint)
    catalogue = load_catalogue(path)
    if not catalogue.document.thresholds:
        hint = "add one, such as {rule: no_collision, per_hour: '< 1e-3'}, or ask for its rates alone"
        raise UsageError(f"{path}: has no thresholds to check", hint)
    return catalogue


def decide_rates(rates: CatalogueRates, strict: bool = False) -> CheckResult:
    """Return the verdicts of a catalogue; its rates stand in the reasons."""
    name, rows = rates.catalogue.document.name, []
    broken = [f"{BROKEN}: {', '.join(rates.errors)}"] if rates.errors else []
    for rule_rate in rates.rates:
        for decision in rule_rate.decisions:
            threshold, total = decision.threshold, rule_rate.totals[decision.threshold.unit]
            numbers = f"{format_probability(total.value)} ({format_interval(total.interval)})"
            reason = "; ".join([f"{numbers} per {threshold.unit}", *decision.reasons, *broken])
            rows.append(Decision(name, rule_rate.rule, "threshold", threshold.text, decision.verdict, reason))
    return CheckResult(tuple(rows), {name: ()}, strict=strict, has_too_many_errors=bool(broken))
