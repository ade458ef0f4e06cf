"""Three verdicts on a threshold: pass, fail, or the interval does not tell."""

from __future__ import annotations

from avrare.estimation.result import Result


def verdict(result: Result, limit: float, strict: bool, confidence: float) -> str:
    """Whether the failure probability stays below ``limit`` (or at it, unless ``strict``).

    Returns:
        "pass" if the whole interval does, "fail" if none of it does, else "inconclusive".
    """
    low, high = result.interval_at(confidence)
    if high < limit or (high == limit and not strict):
        return "pass"
    if low > limit or (low == limit and strict):
        return "fail"
    return "inconclusive"
