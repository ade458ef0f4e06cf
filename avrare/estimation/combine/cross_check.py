"""Cross-check of an estimate: a smaller one by an estimator of another family, and a test whether they agree.

The test compares the logarithms of the two estimates. Each interval has a reach towards the other estimate;
the limit of their distance is the root of the sum of the squared reaches (MOVER, Zou and Donner 2008). For
intervals mean * exp(+-t s) this is a t test in which each has its own degrees of freedom, and it takes exact
intervals as well. An estimate of 0 disagrees where its upper limit lies below the other's lower one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.number_format import format_estimate, format_percent
from avrare.estimation.loop.preflight import check_system
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Estimator, Settings
from avrare.estimation.result import health
from avrare.estimation.result.doubts import open_interval
from avrare.estimation.result.note import Note
from avrare.estimation.result.result import CrossCheckResult, Result
from avrare.plugin.component import Component
from avrare.plugin.registry import default_registry
from avrare.rollout.problem import Problem
from avrare.scenario.cross_check import CrossCheck
from avrare.scenario.validation import check_options

ABOVE, BELOW = 0.95, 0.99
"""Levels of the intervals that the test compares where the check lies above the estimate, and below it.

Estimates by levels are skewed: a small one that misses something, or is just unlucky, reads too low. This
check says less of the estimate, and asks for more (docs/cross-check.md has the rate of false alarms).
"""
_FREQUENT = 1e-2
"""Probability from which on Monte Carlo checks."""
_SEED_KEY = 0xC4EC

Execute = Callable[[Problem, Estimator, Settings], Result]
"""Runs an estimator on a problem with one specification."""


def parse_cross_check(value: CrossCheck | Mapping[str, object] | bool, estimator: str) -> CrossCheck | None:
    """Return the check that an argument of ``avrare.estimate`` asks for, None for False."""
    if isinstance(value, bool):
        check = CrossCheck() if value else None
    elif isinstance(value, CrossCheck):
        check = value
    elif isinstance(value, Mapping):
        check = check_options(CrossCheck, "cross_check", value, kind="argument")
    else:
        raise UsageError(f"cross_check must be true, false or options, not {value!r}")
    if check is not None and (conflict := check.find_conflict(estimator)):
        raise UsageError(f"cross_check: {conflict}", "leave `estimator` out to have one chosen")
    return check


def subtract_check(budget: Budget | None, check: CrossCheck | None) -> Budget | None:
    """Return the part of a budget that is left for the estimate itself."""
    if budget is None or check is None:
        return budget
    return replace(budget, amount=budget.amount / (1.0 + check.share))


def add_cross_check(
    problem: Problem, result: Result, check: CrossCheck, settings: Settings, execute: Execute
) -> Result:
    """Return the result with its cross-check, and with a health warning where the two disagree.

    Args:
        problem: Problem with the result's specification alone.
        result: Estimate to check.
        check: Options.
        settings: Settings of the estimate; the check has its own seed, derived from theirs.
        execute: How to run the check.
    """
    name, built = _choose(check, problem, result, replace(settings, budget=None))
    if built is None:
        return _add_nothing(result, check, name, "no estimator of another family can run this system")
    cost = result.simulated_steps / problem.steps if problem.steps else result.rollouts
    rollouts = check.share * cost / result.shared_by
    sized = built.scale(rollouts, result.probability or 1e-4)  # stands for an estimate of 0
    if sized is None:
        reason = f"{format_percent(check.share)} of the cost pays for only {rollouts:.0f} complete rollouts"
        return _add_nothing(result, check, name, reason)
    seed = np.random.SeedSequence(settings.seed, spawn_key=(_SEED_KEY,)).generate_state(1, np.uint64)[0]
    settings = replace(settings, seed=int(seed), budget=None)
    second = execute(problem, sized, settings)
    outcome, noticed = compare(result, second)
    cross_check = CrossCheckResult(second.estimator, outcome, check.share, noticed, second.without_tapes())
    checked = _add(result, cross_check, _describe(second, outcome, noticed, check.share))
    if outcome != "disagree":
        return checked
    estimates = [
        f"{each.estimator} gives {format_estimate(each.probability, each.interval)}"
        for each in (result, second)
    ]
    reason = f"{estimates[0]}, but its cross-check by {estimates[1]}"
    warning = health.warn("contradicted", reason=reason)
    warnings = {} if "contradicted" in settings.suppress else warning
    return replace(
        open_interval(checked, warning, least_upper=second.interval[1]), health=result.health | warnings
    )


def _choose(
    check: CrossCheck, problem: Problem, result: Result, settings: Settings
) -> tuple[str, Estimator | None]:
    """Return the name of the estimator that checks, and the estimator; None if no estimator can run."""
    checkers = _rank_checkers(check, result)
    for checker in checkers:
        estimator = checker.build(checker.load_config()())
        if _can_run(estimator, problem, settings):
            return checker.name, estimator
    return checkers[0].name if checkers else "", None


def _rank_checkers(check: CrossCheck, result: Result) -> list[Component]:
    """Return the estimators of other families that can check, the most suitable first."""
    registry, frequent = default_registry(), result.probability >= _FREQUENT
    family = registry.family(result.estimator)
    ranks = {}
    for checker in registry.checkers():
        role = checker.cross_check
        if role is not None and checker.family != family:
            chosen, counts = checker.name == check.estimator, frequent and checker.name == MonteCarlo.name
            ranks[not chosen, not counts, family not in role.first_for, role.order, checker.name] = checker
    return [ranks[rank] for rank in sorted(ranks)]


def _can_run(estimator: Estimator, problem: Problem, settings: Settings) -> bool:
    if "branches" in estimator.needs and not problem.steps:
        return False
    try:
        check_system(problem, estimator, settings)
    except UsageError:
        return False
    return True


def compare(result: Result, second: Result) -> tuple[str, float]:
    """Return "agree", "disagree" or "inconclusive", and the factor between them that would be noticed."""
    small, large = sorted((result, second), key=lambda estimate: estimate.probability)
    level = ABOVE if large is second else BELOW
    high, low = small.interval_at(level)[1], large.interval_at(level)[0]
    if not large.probability:
        return "inconclusive", math.inf
    if not small.probability:
        noticed, disagree = max(1.0, high / large.probability), high < low
    else:
        upward = math.log(high / small.probability)
        downward = math.log(large.probability / low) if low > 0.0 else math.inf
        noticed = math.exp(min(math.hypot(upward, downward), 700.0))
        disagree = large.probability > noticed * small.probability
    if disagree:
        return "disagree", noticed
    # a check that would not notice a factor of 10 says nothing
    return ("agree" if noticed <= 10.0 else "inconclusive"), noticed


def _describe(second: Result, outcome: str, noticed: float, share: float) -> str:
    text = format_estimate(second.probability, second.interval)
    if outcome == "inconclusive":
        text += f", and {format_percent(share)} of the cost is too little to say more"
    elif outcome == "agree":
        text += f", and a factor of {noticed:.2g} would have been noticed"
    return f"{text} ({second.rollouts:,} rollouts)"


def _add_nothing(result: Result, check: CrossCheck, name: str, reason: str) -> Result:
    return _add(result, CrossCheckResult(name, "inconclusive", check.share), reason)


def _add(result: Result, cross_check: CrossCheckResult, details: str) -> Result:
    checker = f" by {cross_check.estimator}" if cross_check.estimator else ""
    outcome = {"agree": "agrees", "disagree": "disagrees"}.get(cross_check.outcome, "is inconclusive")
    text = f"Cross-check{checker} {outcome}: {details}."
    return replace(result, cross_check=cross_check, notes=(*result.notes, Note("cross_check", text)))
