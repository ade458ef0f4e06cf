"""Two witnesses of one probability: estimates by unlike methods, which share no failure that they would miss.

Where they agree, and would mostly have disagreed if one had missed failures, the estimate is the mean of the
two, and each answers the doubts about the other. Where they disagree, one of them has missed failures.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import partial
from statistics import NormalDist

import numpy as np

from avrare.base.number_format import format_interval, format_probability
from avrare.estimation.checks.result_builder import contradict
from avrare.estimation.combine.cross_check import compare
from avrare.estimation.result import health, intervals
from avrare.estimation.result.doubts import DOUBTS, MAY_MISS_FAILURES, open_interval, undo_opening
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.estimation.result.result import Result

MISS = 3.0
"""Factor of a miss that a witness must be able to notice."""
LEAST_POWER = 0.5
"""Power below which agreement says nothing: then a miss would mostly have passed as agreement."""


def power_to_notice(threshold: float, errors: tuple[float, float]) -> float:
    """Return the chance that two estimates would have disagreed if they were apart by the factor of a miss.

    Args:
        threshold: Factor between the estimates from which they disagree.
        errors: Their relative errors; NaN where one has found nothing.
    """
    spread = math.sqrt(sum(math.log1p(error**2) for error in errors))
    if not spread or math.isnan(spread) or not math.isfinite(threshold):
        return 0.0
    return NormalDist().cdf((math.log(MISS) - math.log(threshold)) / spread)


def describe_power(power: float) -> str:
    """Describe the power of the comparison."""
    return f"a miss by a factor {MISS:g} would have been noticed in {100 * power:.0f} of 100"


_ANSWERED = frozenset({"unchecked", "contradicted", "few_roots", "leaps"})
"""Doubts that an unlike estimate answers where it agrees."""


def reconcile(first: Result, second: Result, confidence: float) -> tuple[Result, str, str]:
    """Return the result of two witnesses at the cost of both, their outcome, and a description of both.

    Their shares of the mean are equal, whatever they have found. Those of one method miss alike: neither
    answers for a doubt of the other. Which estimate stands where they disagree depends on them, so that one
    is not unbiased; its interval holds both.
    """
    outcome, noticed = compare(undo_opening(first), undo_opening(second))
    power = power_to_notice(noticed, (first.relative_error, second.relative_error))
    if outcome == "agree" and power < LEAST_POWER:
        outcome = "inconclusive"
    fresh = _fresh_rows(first) + _fresh_rows(second)
    names = f"`{first.estimator}` and `{second.estimator}`"
    if outcome == "agree":
        result = _mean(first, second)
        words = f"{names} agree, and {describe_power(power)}"
    elif outcome == "disagree":
        low, result = sorted((first, second), key=lambda witness: witness.probability)
        if not MAY_MISS_FAILURES.intersection(low.health):  # else its finding less is no news
            reason = (
                f"{result.estimator} gives {_describe(result)}, but {low.estimator} gives {_describe(low)}"
            )
            both = partial(intervals.hull, low.interval_at, result.interval_at)
            doubts = result.health | health.warn("contradicted", reason=reason)
            result = replace(result, interval_at=both, unopened_at=None, health=doubts)
        words = f"{names} disagree, and the larger estimate stands"
    else:
        surer = second.relative_error < first.relative_error
        better = surer and in_doubt(first) and not in_doubt(second)
        result, other = (second, first) if better else (first, second)
        words = f"`{other.estimator}` says too little: {describe_power(power)}"
    result = replace(
        result,
        rollouts=first.rollouts + second.rollouts,
        simulated_steps=first.simulated_steps + second.simulated_steps,
        errors=first.errors + second.errors,
        seconds=first.seconds + second.seconds,
        counts=dict(sorted((Counter(first.counts) + Counter(second.counts)).items())),
        fresh=fresh,
        blind_bound=fresh.blind_bound(confidence),
        diagnostics={**result.diagnostics, "witnesses": _numbers(first, second, outcome, power)},
    )
    plain = undo_opening(result)
    doubts = result.health | contradict(plain)
    return replace(open_interval(plain, doubts), health=doubts), outcome, words


def _mean(first: Result, second: Result) -> Result:
    pair = (first, second)
    values = np.array([witness.probability for witness in pair])
    mean = float(values.mean())
    variance = sum((witness.relative_error * witness.probability / mean / 2.0) ** 2 for witness in pair)
    errors = max(witness.errors / max(witness.rollouts, 1) for witness in pair)
    answered = _ANSWERED if first.estimator != second.estimator else frozenset[str]()
    warnings = [
        {name: text for name, text in witness.health.items() if name not in answered} for witness in pair
    ]
    doubted = (witness for witness, health in zip(pair, warnings, strict=True) if DOUBTS.intersection(health))
    weights = first.failures.weights
    if weights is not None:
        weights = weights * (mean / first.probability)
    return replace(
        first,
        probability=mean,
        run_probabilities=values,
        relative_error=float(np.sqrt(variance)),
        interval_at=partial(intervals.log_normal, mean, variance, freedom=8, errors=errors),
        unopened_at=None,
        least_upper=max((witness.least_upper for witness in doubted), default=0.0),
        health=warnings[1] | warnings[0],
        failures=replace(first.failures, weights=weights),
    )


def in_doubt(result: Result) -> bool:
    """Return whether a warning doubts the interval of a result."""
    return bool(DOUBTS.intersection(result.health))


def _fresh_rows(result: Result) -> FreshRows:
    """Return the counts of rollouts drawn from the target: all of Monte Carlo's."""
    if result.fresh is not None:
        return result.fresh
    return FreshRows(result.rollouts, result.failures.count, result.errors)


def _describe(result: Result) -> str:
    return f"{format_probability(result.probability)} ({format_interval(undo_opening(result).interval)})"


def _numbers(first: Result, second: Result, outcome: str, power: float) -> dict[str, object]:
    witnesses = [
        {
            "estimator": witness.estimator,
            "probability": witness.probability,
            "relative_error": witness.relative_error,
        }
        for witness in (first, second)
    ]
    return {"outcome": outcome, "power": power, "estimates": witnesses}
