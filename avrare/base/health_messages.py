"""Health warnings: names, which a scenario may suppress, and messages."""

from __future__ import annotations

from collections.abc import Collection

from avrare.base.errors import UsageError, did_you_mean

MESSAGES = {
    "errors": "{errors} of {rollouts} rollouts ended in an error, more than {allowed:.1%} allowed: {message}",
    "extinct": "all {runs} runs died out before they reached a failure: only the upper bound from "
    "their first rollouts is known; use more particles or fewer discards (in `ess`, more chains)",
    "extinct_runs": "{extinct} of {runs} runs died out and count as 0; use more particles or fewer discards "
    "(in `ess`, more chains)",
    "single_run": "only one run: its interval relies on its genealogy and is too narrow for rare events",
    "few_roots": "half of the runs descend from fewer than {least} first particles: use more particles "
    "or chains",
    "flat_part": "`{part}` is kept by the same margin in every rollout tried: nothing shows how near its "
    "failures are, and they could be as likely as {bound:.2g}; more first rollouts lower this bound, a score "
    "function that rises on the way there finds them",
    "outliers": "failures that begin with {what} {when} have a probability of at least {low:.2g}, and the "
    "estimate's interval ends at {upper:.2g}: it misses them; use mc, more first rollouts, or is with a "
    "learned proposal",
    "leaps": "{share:.0%} of the first rollouts that pass the level of 1 % come from below that of 10 % in a "
    "single step: there is no way up to failures that one outlier decides, and runs that have met none of "
    "them agree on too low a probability; compare with ess, mc, or is with a learned proposal",
    "ties": "half of the levels discarded more than {share:.0%} of the particles instead of {discard}: "
    "the score takes too few values for splitting",
    "horizon_short": "the formula looks {horizon} samples ahead but a rollout has {steps} step(s): windows "
    "are clipped at its last sample",
    "solver_failures": "{fallbacks} of {solves} solves of the controller failed: it reused its last plan",
    "not_deterministic": "{reason}: the system depends on more than its noise, and this result cannot be "
    "reproduced",
    "rounding": "{reason}: rounding depends on the batch; the estimate is sound, but a replay may differ in "
    "the last digits",
    "all_failed": "every rollout failed: the scenario cannot show how rare failures are",
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
    "pilot_disagrees": "{failures} of {rows} rollouts of the pilot failed, a probability of {counted}, but "
    "the estimate's interval was {interval}: it misses failures, and is widened to hold those of the pilot; "
    "use mc",
    "heuristic_kernel": "{note}",
    "lipschitz_exceeded": "{steep} of {pairs} pairs of tapes differ by more than lipschitz: {slope:g} "
    "allows, by up to {most:.3g} per unit of length: it is not a bound, and the estimate may be biased; "
    "raise it, or use kernel shrink",
    "model_error": "{note}",
    "flow_tails": "{note}",
    "paper_weights": "{note}",
    "estimators_disagree": "{estimator} gives {own}, but its cross-check by {other} gives {others}: at "
    "least one of them misses failures, and neither can be trusted; repeat both with more particles or "
    "chains, or with another score",
    "model_unknown": "a member of the ensemble met no failure: its part of the interval is a rough one; use "
    "more rollouts",
    "unreached": "after {stages} stages the elite has not reached failure: the proposal is unsuitable; use "
    "more stages or more rollouts",
}


def check_names(suppress: Collection[str]) -> None:
    """Check that the warnings of these names may be suppressed."""
    for name in suppress:
        if name not in MESSAGES:
            raise UsageError(f"there is no health warning {name!r}", did_you_mean(name, MESSAGES))
        if name == "errors":
            raise UsageError("health warning 'errors' cannot be suppressed", "raise max_error_rate instead")
