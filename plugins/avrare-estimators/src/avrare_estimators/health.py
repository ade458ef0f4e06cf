"""Health warnings of these estimators: their texts, and the checks that raise them."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from avrare.base.health_messages import MESSAGES, fill
from avrare.estimation.health import check_errors

__all__ = ["WARNINGS", "check_errors", "check_runs", "check_ties", "check_weights", "warn"]

WARNINGS = {
    "extinct": "all {runs} runs died out before they reached a failure: only the upper bound from "
    "their first rollouts is known; use more particles or fewer discards (in `ess`, more chains)",
    "extinct_runs": "{extinct} of {runs} runs died out and count as 0; use more particles or fewer discards "
    "(in `ess`, more chains)",
    "few_roots": "half of the runs descend from fewer than {least} first particles: use more particles "
    "or chains",
    "leaps": "{share:.0%} of the first rollouts that pass the level of 1 % come from below that of 10 % in a "
    "single step: there is no way up to failures that one outlier decides, and runs that have met none of "
    "them agree on too low a probability; compare with ess, mc, or is with a learned proposal",
    "ties": "half of the levels discarded more than {share:.0%} of the particles instead of {discard}: "
    "the score takes too few values for splitting",
    "no_failures": "no rollout failed: the proposal does not reach a failure, and the probability is known "
    "only to lie below the upper end of the interval",
    "weight_mean": "the mean weight is {mean:.3g} +- {error:.2g} instead of 1: the weights are "
    "wrong, or the sample misses much of the target; raise `defensive`",
    "weight_degenerate": "the effective number of failures is {effective:.1f}, the largest weight "
    "has a share of {largest:.0%}: the interval is widened to hold for any weights; use more rollouts "
    "or a proposal closer to the failures",
    "cross_check": "{reason}: the interval is widened to hold whatever the proposal misses; use ams or ess, "
    "or a proposal that reaches all failures",
    "unchecked": "{reason}: missed failures cannot be ruled out, and the interval is widened to hold "
    "whatever is missed; use more rollouts, or compare with ams or ess",
    "uncovered": "{share:.0%} of the failures that learning has met lie where the proposal hardly draws more "
    "than the target does: it misses a kind of failure, and the interval is widened to hold whatever is "
    "missed; use a larger `pilot`, or ams or ess",
    "stages_disagree": "stages of learning estimate {stages}: one of them misses failures, and the interval "
    "is widened to hold whatever is missed; use more rollouts, or compare with ams or ess",
    "heuristic_kernel": "{note}",
    "lipschitz_exceeded": "{steep} of {pairs} pairs of tapes differ by more than lipschitz: {slope:g} "
    "allows, by up to {most:.3g} per unit of length: it is not a bound, and the estimate may be biased; "
    "raise it, or use kernel shrink",
    "unreached": "after {stages} stages the elite has not reached failure: the proposal is unsuitable; use "
    "more stages or more rollouts",
}
"""Name to text, for the descriptions of the estimators."""

FEWEST_ROOTS = 15
MOST_TIES = 2.0
"""Ratio of discarded to requested particles, median over the levels."""
LEAST_EFFECTIVE = 15.0
LARGEST_SHARE = 0.3
LARGEST_DEVIATION = 4.0
LARGEST_MEAN_ERROR = 0.5


def warn(name: str, **values: object) -> dict[str, str]:
    """Return one of these warnings, or of the core's, with its text filled in."""
    return fill(MESSAGES | WARNINGS, name, **values)


def check_ties(discarded: Sequence[int], discard: int, particles: int) -> dict[str, str]:
    """Return a warning when most levels, of all runs, discard many more particles than ``discard``."""
    if not discarded or (typical := median(discarded)) <= MOST_TIES * discard:
        return {}
    return warn("ties", share=typical / particles, discard=discard)


def check_runs(values: Sequence[float], extinct: int, roots: Sequence[int]) -> dict[str, str]:
    """Return the warnings on splitting runs; ``roots``: first particles whose descendants survive."""
    runs = len(values)
    found = warn("single_run") if runs == 1 else {}
    if not any(values):
        return found | warn("extinct", runs=runs)
    if extinct:
        found |= warn("extinct_runs", extinct=extinct, runs=runs)
    if median(roots) < FEWEST_ROOTS:
        found |= warn("few_roots", least=FEWEST_ROOTS)
    return found


def check_weights(mean: float, error: float, effective: float, largest: float) -> dict[str, str]:
    """Return the warnings on importance weights.

    Args:
        mean: Mean weight.
        error: Standard error of the mean weight.
        effective: Effective number of failing contributions; 0 without failures.
        largest: The largest contribution's share of the estimate.
    """
    found: dict[str, str] = {}
    if abs(mean - 1.0) > LARGEST_DEVIATION * error + 1e-9 or error > LARGEST_MEAN_ERROR * mean:
        found |= warn("weight_mean", mean=mean, error=error)
    if effective == 0.0:
        return found | warn("no_failures")
    if effective < LEAST_EFFECTIVE or largest > LARGEST_SHARE:
        found |= warn("weight_degenerate", effective=effective, largest=largest)
    return found
