"""Three verdicts on a threshold: pass, fail, or the interval does not tell."""

from __future__ import annotations

from avrare.estimation import intervals
from avrare.estimation.result import Interval, Result


def interval_at(result: Result, confidence: float) -> Interval:
    """The result's interval at another confidence."""
    if confidence == result.confidence:
        return result.interval
    if result.estimator == "mc":
        return intervals.clopper_pearson(result.failures.count, result.rollouts, confidence, result.errors)
    if result.probability > 0.0 and len(result.run_probabilities) > 1:
        return intervals.of_runs(result.run_probabilities.tolist(), confidence)
    return 0.0, 1.0


def verdict(result: Result, limit: float, strict: bool, confidence: float) -> str:
    """Whether the failure probability stays below ``limit`` (or at it, unless ``strict``).

    Returns:
        "pass" if the whole interval does, "fail" if none of it does, else "inconclusive".
    """
    low, high = interval_at(result, confidence)
    if high < limit or (high == limit and not strict):
        return "pass"
    if low > limit or (low == limit and strict):
        return "fail"
    return "inconclusive"
