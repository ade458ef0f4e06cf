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
from avrare.base.number_format import format_percent
from avrare.base.special_functions import beta_cdf
from avrare.estimation.result.confidence_distributions import (
    Binomial,
    InverseBinomial,
    derive_distribution,
)
from avrare.estimation.result.result import Result
from avrare.scenario.schema import Regression, Threshold

POWER = 0.9
BASELINE_SHARE = 0.25
"""Share of the variance of a comparison that the baseline should have: it is paid once, checks often."""
LEAST_SHARE = 0.1
"""Share of the variance that a baseline must leave for a check."""
_MAX_FAILURES = 200
_quantile = NormalDist().inv_cdf


@dataclass(frozen=True)
class AutoLimits:
    """Limits of ``auto``: rollouts, and a relative error at which it ends earlier, if it has one."""

    rollouts: int
    relative_error: float | None


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
    auto: AutoLimits | None = None,
) -> list[CostEstimate]:
    """Predict the cost of a verdict on each criterion, with and without assumptions, and of +-20 %.

    ``earlier`` estimates, by specification, have a ``source``; ``confidence`` is that of the +-20 %. ``auto``
    says where that estimator ends; None: the estimator is another.
    """
    needs = [
        (
            criterion.question,
            entry,
            _need_of_auto(_need_for_criterion(criterion, entry, len(criteria)), entry, auto),
        )
        for criterion in criteria
        if (entry := earlier.get(criterion.specification)) is not None
    ]
    needs += [
        (f"{criterion.question}, all seen", entry, _need_to_settle(criterion.condition, entry))
        for criterion in criteria
        if isinstance(criterion.condition, Threshold)
        and (entry := earlier.get(criterion.specification)) is not None
        and not counts_failures(entry)
    ]
    needs += [
        ("+-20 %", entry, _need_of_auto(_need_for_precision(entry, confidence), entry, auto))
        for entry in earlier.values()
    ]
    return [_estimate_cost(scenario, question, entry, *need, source) for question, entry, need in needs]


def _estimate_cost(
    scenario: str, question: str, entry: Result, rollouts: float | None, reason: str, source: str
) -> CostEstimate:
    if rollouts is None:
        return CostEstimate(scenario, entry.specification, question, None, 0, 0.0, reason)
    needed = _round(rollouts)
    share = needed / entry.rollouts
    text = f"{reason}, by {source}" if reason else f"by {source}"
    steps = round(entry.simulated_steps * share)
    return CostEstimate(scenario, entry.specification, question, needed, steps, entry.seconds * share, text)


def _round(rollouts: float) -> int:
    rollouts = max(rollouts, 1.0)  # an earlier estimate without any error of its own
    digits = max(0, math.floor(math.log10(rollouts)) - 1)  # the prediction is good to two digits at most
    unit = int(10**digits)
    return math.ceil(rollouts / unit) * unit


def _need_to_settle(threshold: Threshold, entry: Result) -> _Need:
    rollouts = count_settling_rollouts(threshold, entry.probability)
    if rollouts is None:
        return None, "the estimate is too near the bound, or above it: Monte Carlo may not decide"
    return rollouts, "of Monte Carlo, which sees failures that no score leads to"


def count_settling_rollouts(threshold: Threshold, probability: float) -> int | None:
    """Return the Monte Carlo rollouts that prove a threshold in 9 of 10 cases, without trusting a search.

    At least 3.7 / limit at 95 % confidence; None where the probability is near the limit, or above it.
    """
    if not probability < threshold.limit < 1.0:
        return None
    return _rollouts_to_pass(probability, threshold.limit, (1.0 - threshold.confidence) / 2.0)


def _need_for_precision(entry: Result, confidence: float) -> _Need:
    if not _has_variance(entry):
        return None, _explain_missing_failures(entry)
    precision = 0.2  # half width of the relative interval that is priced for every specification
    return _work(entry) * (_quantile(1.0 - (1.0 - confidence) / 2.0) / math.log1p(precision)) ** 2, ""


def _need_for_criterion(criterion: Criterion, entry: Result, criteria: int) -> _Need:
    if isinstance(criterion.condition, Threshold):
        return _need_for_threshold(criterion.condition, entry, criteria)
    return _need_for_regression(criterion.condition, entry, criterion.baseline, criteria)


def _need_of_auto(need: _Need, entry: Result, auto: AutoLimits | None) -> _Need:
    rollouts, reason = need
    if auto is None or (rollouts is None and reason != _explain_missing_failures(entry)):
        return need
    if rollouts is None or rollouts > auto.rollouts:
        if auto.relative_error is None:
            return auto.rollouts, "all that auto may take"
        return auto.rollouts, f"at most, to a relative error of {format_percent(auto.relative_error)}"
    # What it learns costs as much for every estimate.
    return (rollouts if counts_failures(entry) else max(rollouts, entry.rollouts)), reason


def counts_failures(entry: Result) -> bool:
    """Return whether an estimate is by Monte Carlo."""
    return isinstance(derive_distribution(entry), (Binomial, InverseBinomial))


def _need_for_threshold(threshold: Threshold, entry: Result, criteria: int) -> _Need:
    limit, tail, p = threshold.limit, (1.0 - threshold.confidence) / 2.0, entry.probability
    if p == limit or limit in (0.0, 1.0) or p == 1.0:
        reason = "the estimate equals the bound, or one of them is 0 or 1: no number of rollouts may decide"
        return None, reason
    fails = p > limit
    reason = "expected to fail" if fails else "" if p > 0.0 else "if nothing fails"
    if counts_failures(entry):
        exact = _rollouts_to_fail(p, limit, tail / criteria) if fails else _rollouts_to_pass(p, limit, tail)
        if exact is not None:
            return exact, reason
    if not _has_variance(entry):
        return None, _explain_missing_failures(entry)
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


def find_variance(regression: Regression, criteria: int = 1) -> float:
    """Return the relative variance of both estimates together that decides a comparison in 9 of 10 cases."""
    tail = (1.0 - regression.confidence) / 2.0 / criteria
    ratio = regression.excluded / regression.ratio
    return (math.log(ratio) / (_quantile(1.0 - tail) + _quantile(POWER))) ** 2


def _need_for_regression(
    regression: Regression, entry: Result, baseline: Result | None, criteria: int = 1
) -> _Need:
    if not (_has_variance(entry) and (baseline is None or _has_variance(baseline))):
        both = baseline is not None
        return (
            None,
            "no failures: the change is not known; use a threshold"
            if both
            else _explain_missing_failures(entry),
        )
    variance = find_variance(regression, criteria)
    factor = f"to see a factor of {regression.excluded / regression.ratio:g}"
    allowed = math.sqrt(BASELINE_SHARE * variance)
    for_baseline = _round(_work(baseline or entry) / allowed**2)
    if baseline is None:
        return for_baseline, f"for the baseline, {factor}; each check takes a third of that"
    spread, least = find_spread(baseline), LEAST_SHARE * variance
    left = variance - spread**2
    if left <= least:
        errors = [format_percent(round(error, 2)) for error in (spread, allowed)]
        text = f"the baseline is too imprecise: its relative error is {errors[0]}, not {errors[1]} or less"
        doubted = variance - baseline.relative_error**2 > least  # its size is not what it lacks
        words = "--seed N" if doubted else f"--budget rollouts={for_baseline}"
        return None, f"{text}; make another with --save {words}"
    return _work(entry) / left, factor


def describe_coarse_baseline(regression: Regression, entry: Result) -> str:
    """Return why an estimate, as a baseline, decides no check, and what would; empty if it does."""
    need, reason = _need_for_regression(regression, entry, entry)
    return reason if need is None else ""


def find_spread(entry: Result) -> float:
    """Return the relative error that corresponds to an interval, which doubts may have widened."""
    if counts_failures(entry):
        return entry.relative_error
    level = 0.95
    low, high = derive_distribution(entry).interval_at(level)
    if not low:
        return math.inf
    return max(entry.relative_error, math.log(high / low) / 2.0 / _quantile((1.0 + level) / 2.0))


def _has_variance(entry: Result) -> bool:
    return entry.probability > 0.0 and math.isfinite(entry.relative_error)


def _explain_missing_failures(entry: Result) -> str:
    return f"no failures in {entry.rollouts:,} rollouts: the number needed is unknown"


def _work(entry: Result) -> float:  # relative variance times rollouts
    return entry.relative_error**2 * entry.rollouts
