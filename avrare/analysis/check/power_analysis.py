"""Power analysis: cost of a verdict, predicted from the cost and the precision of an earlier estimate.

The relative variance of an estimate times its rollouts does not depend on their number. From it follows how
many rollouts give an error small enough to reach a verdict with a probability of 90 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

from avrare.analysis.check.criteria import Criterion
from avrare.base.special_functions import beta_cdf
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    InverseBinomial,
    derive_distribution,
)
from avrare.estimation.result.result import Result
from avrare.scenario.schema import Regression, Threshold

POWER = 0.9
PRECISION = 0.2
"""Half width of the relative interval that is priced for every specification."""
_MAX_FAILURES = 200
_quantile = NormalDist().inv_cdf


@dataclass(frozen=True)
class CostEstimate:
    """Predicted cost of one verdict."""

    scenario: str
    specification: str
    question: str  # the criterion in symbols
    rollouts: int | None  # needed; None where they cannot be predicted
    steps: int
    seconds: float  # wall time with one worker, at the speed of the earlier estimate
    reason: str  # source of the numbers, or why there are none


_Need = tuple[float | None, str]  # rollouts needed, None if unknown, and the reason


def estimate_costs(
    scenario: str,
    criteria: Sequence[Criterion],
    earlier: Mapping[str, Result],
    source: str,
    confidence: float,
) -> list[CostEstimate]:
    """Predict the cost of a verdict on each criterion, with and without what a search assumes, and of +-20 %.

    ``earlier`` estimates, by specification, have a ``source``; ``confidence`` is that of the +-20 %.
    """
    needs = [
        (criterion.question, entry, _need_for_criterion(criterion, entry, len(criteria)))
        for criterion in criteria
        if (entry := earlier.get(criterion.specification)) is not None
    ]
    needs += [
        (f"{criterion.question}, all seen", entry, _need_to_settle(criterion.condition, entry))
        for criterion in criteria
        if isinstance(criterion.condition, Threshold)
        and (entry := earlier.get(criterion.specification)) is not None
        and not isinstance(derive_distribution(entry), (Binomial, InverseBinomial))
    ]
    needs += [("+-20 %", entry, _need_for_precision(entry, confidence)) for entry in earlier.values()]
    return [_price(scenario, question, entry, *need, source) for question, entry, need in needs]


def _price(
    scenario: str, question: str, entry: Result, rollouts: float | None, reason: str, source: str
) -> CostEstimate:
    if rollouts is None:
        return CostEstimate(scenario, entry.specification, question, None, 0, 0.0, reason)
    rollouts = max(rollouts, 1.0)  # an earlier estimate without any error of its own
    digits = max(0, math.floor(math.log10(rollouts)) - 1)  # the prediction is good to two digits at most
    needed = math.ceil(rollouts / 10**digits) * 10**digits
    share = needed / entry.rollouts
    text = f"{reason}, by {source}" if reason else f"by {source}"
    steps = round(entry.simulated_steps * share)
    return CostEstimate(scenario, entry.specification, question, needed, steps, entry.seconds * share, text)


def _need_to_settle(threshold: Threshold, entry: Result) -> _Need:
    rollouts = count_settling_rollouts(threshold, entry.probability)
    if rollouts is None:
        return None, "the estimate is too near the bound, or above it: Monte Carlo may not decide"
    return rollouts, "of Monte Carlo, which sees failures that no score leads to"


def count_settling_rollouts(threshold: Threshold, probability: float) -> int | None:
    """Return the rollouts of Monte Carlo that prove a threshold in 9 of 10 cases, whatever a search missed.

    At least 3.7 / limit at 95 % confidence; None where the probability is near the limit, or above it.
    """
    if not probability < threshold.limit < 1.0:
        return None
    return _rollouts_to_pass(probability, threshold.limit, (1.0 - threshold.confidence) / 2.0)


def _need_for_precision(entry: Result, confidence: float) -> _Need:
    if not _has_variance(entry):
        return None, _no_failures(entry)
    return _work(entry) * (_quantile(1.0 - (1.0 - confidence) / 2.0) / math.log1p(PRECISION)) ** 2, ""


def _need_for_criterion(criterion: Criterion, entry: Result, criteria: int) -> _Need:
    tail = (1.0 - criterion.condition.confidence) / 2.0
    if isinstance(criterion.condition, Threshold):
        return _need_for_threshold(criterion.condition.limit, entry, tail, criteria)
    return _need_for_regression(criterion.condition, entry, criterion.baseline, tail / criteria)


def _need_for_threshold(limit: float, entry: Result, tail: float, criteria: int) -> _Need:
    p = entry.probability
    if p == limit or limit in (0.0, 1.0) or p == 1.0:
        reason = "the estimate equals the bound, or one of them is 0 or 1: no number of rollouts may decide"
        return None, reason
    fails = p > limit
    reason = "expected to fail" if fails else "" if p > 0.0 else "if nothing fails"
    if isinstance(derive_distribution(entry), (Binomial, InverseBinomial)):
        exact = _rollouts_to_fail(p, limit, tail / criteria) if fails else _rollouts_to_pass(p, limit, tail)
        if exact is not None:
            return exact, reason
    if not _has_variance(entry):
        return None, _no_failures(entry)
    level = tail / criteria if fails else tail
    return _work(entry) * ((_quantile(1.0 - level) + _quantile(POWER)) / math.log(limit / p)) ** 2, reason


def _rollouts_to_pass(p: float, limit: float, tail: float) -> int | None:
    # Monte Carlo rollouts that prove the bound with ``POWER``; None beyond 200 failures
    for failures in range(_MAX_FAILURES):

        def is_proven(trials: int, failures: int = failures) -> bool:
            return beta_cdf(1.0 - limit, trials - failures, failures + 1) <= tail

        rollouts = _find_first(is_proven, failures + 1)
        if beta_cdf(1.0 - p, rollouts - failures, failures + 1) >= POWER:
            return rollouts
    return None


def _rollouts_to_fail(p: float, limit: float, tail: float) -> int | None:
    # Monte Carlo rollouts that refute the bound with ``POWER``; None beyond 200 failures
    for failures in range(1, _MAX_FAILURES):

        def likely(trials: int, failures: int = failures) -> bool:
            return beta_cdf(limit, failures, trials - failures + 1) > tail

        rollouts = _find_first(likely, failures) - 1  # the most for which so many failures refute the bound
        if rollouts >= failures and beta_cdf(p, failures, rollouts - failures + 1) >= POWER:
            return rollouts
    return None


def _find_first(holds: Callable[[int], bool], start: int) -> int:
    low, high = start - 1, start
    while not holds(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _need_for_regression(
    regression: Regression, entry: Result, baseline: Result | None, tail: float
) -> _Need:
    if not (_has_variance(entry) and (baseline is None or _has_variance(baseline))):
        return None, "no failures: the ratio cannot be estimated; use a threshold"
    ratio = regression.excluded / regression.ratio
    allowed = (math.log(ratio) / (_quantile(1.0 - tail) + _quantile(POWER))) ** 2
    if baseline is None:
        return 2.0 * _work(entry) / allowed, f"for the baseline and each check, to see a factor of {ratio:g}"
    left = allowed - baseline.relative_error**2
    if left <= 0.1 * allowed:
        needed = f"{math.ceil(2.0 * _work(baseline) / allowed):,} rollouts"
        return None, f"the baseline is too imprecise: it needs {needed}, and each check as many"
    return _work(entry) / left, f"to see a factor of {ratio:g}"


def _has_variance(entry: Result) -> bool:
    return entry.probability > 0.0 and math.isfinite(entry.relative_error)


def _no_failures(entry: Result) -> str:
    return f"no failures in {entry.rollouts:,} rollouts: the number needed is unknown"


def _work(entry: Result) -> float:  # relative variance times rollouts
    return entry.relative_error**2 * entry.rollouts
