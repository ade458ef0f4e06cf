"""Rules that end learning, from the entries of its stages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

LEAST_GAIN = 2.0
"""Gain over Monte Carlo from which a proposal is worth drawing from."""
FEWEST_KNOWN = 40.0
"""Effective number of failures that must be known where the elite is not of failures alone."""


def is_learnt(stages: Sequence[dict[str, Any]], most: int) -> bool:
    """Return whether stages with these entries are as many as allowed, or failures' variance has stalled."""
    if len(stages) > most:
        return True
    variances = [stage["relative_variance"] for stage in stages[1:] if stage["reached"]]
    return len(variances) > 1 and variances[-1] > 0.8 * variances[-2]  # learning has nothing left to gain


def gain_nothing(stages: Sequence[dict[str, Any]]) -> bool:
    """Return whether two stages in a row have gained nothing, and the gain does not rise."""
    last = stages[-2:]
    hopeless = len(stages) > 2 and all(is_worthless(stage) for stage in last)
    # learning continues while its gain rises, however small it is
    return hopeless and not (last[1]["gain"] or 0.0) > 1.25 * (last[0]["gain"] or 0.0)


def is_stuck(stages: Sequence[dict[str, Any]]) -> bool:
    """Return whether two stages in a row have found nothing nearer to failure: they are at a plateau."""
    levels = [stage["level"] for stage in stages[-3:]]
    return len(levels) == 3 and None not in levels and levels[2] <= levels[0]


def is_worthless(stage: dict[str, Any]) -> bool:
    """Return whether a stage's proposal is hardly better than the target, even at the level of its elite.

    The gain is that for the rows which the proposal was fitted to; failures of rows that were drawn from the
    one before it must not contradict.
    """
    gain = stage.get("gain_shown")
    if gain is not None and gain < 1.2:  # two stages in a row that show less end learning
        return True
    return stage["gain"] is None or stage["gain"] < LEAST_GAIN


def has_reached(stage: dict[str, Any]) -> bool:
    """Return whether learning knows failures: its elite are failures, or enough of them are among it."""
    return bool(stage["reached"]) or stage.get("failures_effective", 0.0) >= FEWEST_KNOWN
