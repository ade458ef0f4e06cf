"""Health warnings of these estimators."""

from __future__ import annotations

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
    "lipschitz_exceeded": "{steep} of {pairs} pairs of tapes differ by more than bound: {slope:g} "
    "allows, by up to {most:.3g} per unit of length: it is not a bound, and the estimate may be biased; "
    "raise it, or use kernel shrink",
    "unreached": "after {stages} stages the elite has not reached failure: the proposal is unsuitable; use "
    "more stages or more rollouts",
}
"""Name to text."""
