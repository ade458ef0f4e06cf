"""Health: what should make a reader doubt a number, by name."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from statistics import fmean, median, pstdev

from avrare.errors import UsageError, did_you_mean

MESSAGES = {
    "errors": "{errors} of {rollouts} rollouts broke down, more than the {allowed:.1%} allowed: {message}",
    "extinct": "all {runs} runs died out before they reached a failure: the probability may be anything; "
    "use more particles or fewer discards",
    "extinct_runs": "{extinct} of {runs} runs died out and count as 0; use more particles or fewer discards",
    "single_run": "one run only: its interval rests on its genealogy and is too narrow for rare events",
    "few_roots": "half of the runs descend from fewer than {least} first particles: use more particles",
    "scattered_runs": "the runs' relative standard deviation is {spread:.2f}: use more particles",
    "ties": "half of the levels discarded more than {share:.0%} of the particles, {discard} were asked for: "
    "the score takes too few values to split on",
    "horizon_short": "the formula looks {horizon} samples ahead but a run has {steps} steps: what lies "
    "beyond counts as if the trace ended there",
    "solver_failures": "{fallbacks} of {solves} solves of the controller failed: it kept its last plan",
    "not_deterministic": "the same noise gave robustness {first:.6g} and then {again:.6g}: the system "
    "does not depend on its noise alone, and no number here can be reproduced",
    "all_failed": "every rollout failed: the scenario tells nothing about how often",
    "no_failures": "no rollout failed: the proposal does not reach a failure, and the probability may be "
    "anything below the interval's upper end",
    "weight_mean": "the mean weight is {mean:.3g} +- {error:.2g} where it should be 1: the weights are "
    "wrong, or the sample misses much of the target; raise `defensive`",
    "weight_degenerate": "the estimate rests on {effective:.1f} equal rollouts' worth of weight, the largest "
    "has {largest:.0%} of it: the interval is widened to what holds whatever the weights; use more rollouts "
    "or a nearer proposal",
    "cross_check": "a small splitting run finds failures that are likelier than those of the sample "
    "({surprise:.1f} standard errors, {unseen:.0%} beyond all it has weighed): the proposal misses some, and "
    "the interval is widened to what holds whatever it misses",
    "unchecked": "the second look did not come to failure: nothing vouches that the proposal misses none; "
    "use more rollouts, or compare with splitting",
    "heuristic_kernel": "{note}",
    "lipschitz_exceeded": "{steep} of {pairs} pairs of tapes differ by more than lipschitz: {slope:g} "
    "allows, by up to {most:.3g} per unit of length: it is no bound, and the estimate may be biased; "
    "raise it, or use kernel shrink",
    "model_error": "{note}",
    "flow_tails": "{note}",
    "paper_weights": "{note}",
    "unreached": "after {stages} stages the elite still lies short of failure: the proposal is unfit; use "
    "more stages or more rollouts",
}
FEWEST_ROOTS = 5
MOST_TIES = 2.0
"""Discards over those asked for, at half of the levels."""
LARGEST_SPREAD = 0.7
LEAST_EFFECTIVE = 15.0
LARGEST_SHARE = 0.3
LARGEST_SURPRISE = 3.0
MOST_UNSEEN = 0.5
LARGEST_DEVIATION = 4.0
LARGEST_MEAN_ERROR = 0.5


def warn(name: str, **values: object) -> dict[str, str]:
    """One named warning with its message filled in."""
    return {name: MESSAGES[name].format(**values)}


def check_names(suppress: Collection[str]) -> None:
    """Whether health warnings of these names may be left out.

    Raises:
        UsageError: There is no such warning, or it must be seen.
    """
    for name in suppress:
        if name not in MESSAGES:
            raise UsageError(f"there is no health warning {name!r}", did_you_mean(name, MESSAGES))
        if name == "errors":
            raise UsageError("health warning 'errors' cannot be suppressed", "raise max_error_rate instead")


def of_errors(errors: int, rollouts: int, allowed: float, messages: Sequence[str]) -> dict[str, str]:
    """Warns when more than the allowed share of rollouts broke down."""
    if errors <= allowed * rollouts:
        return {}
    return warn(
        "errors", errors=errors, rollouts=rollouts, allowed=allowed, message="; ".join(messages[:2]) or "?"
    )


def of_ties(discarded: Sequence[int], discard: int, particles: int) -> dict[str, str]:
    """Warns when most levels discard many more than asked for.

    Args:
        discarded: At each level of each run.
        discard: K.
        particles: N.
    """
    if not discarded or (typical := median(discarded)) <= MOST_TIES * discard:
        return {}
    return warn("ties", share=typical / particles, discard=discard)


def of_runs(values: Sequence[float], extinct: int, roots: Sequence[int]) -> dict[str, str]:
    """Warnings on independent splitting runs.

    Args:
        values: Run probabilities.
        extinct: Runs that died out.
        roots: First particles that the survivors of each run descend from.
    """
    runs = len(values)
    found = warn("single_run") if runs == 1 else {}
    if not any(values):
        return found | warn("extinct", runs=runs)
    if extinct:
        found |= warn("extinct_runs", extinct=extinct, runs=runs)
    if median(roots) < FEWEST_ROOTS:
        found |= warn("few_roots", least=FEWEST_ROOTS)
    spread = pstdev(values) / fmean(values)
    if spread > LARGEST_SPREAD:
        found |= warn("scattered_runs", spread=spread)
    return found


def of_weights(
    mean: float, error: float, effective: float, largest: float, surprise: float, unseen: float
) -> dict[str, str]:
    """Warnings on importance weights.

    Args:
        mean: Mean weight.
        error: Its standard error.
        effective: Effective number of failing contributions; 0 without failures.
        largest: The largest contribution's share of the estimate.
        surprise: Standard errors by which a second look contradicts the sample; 0 where there was none.
        unseen: Share of the failures of a second look whose weight is above all of the sample's.
    """
    found: dict[str, str] = {}
    if abs(mean - 1.0) > LARGEST_DEVIATION * error + 1e-9 or error > LARGEST_MEAN_ERROR * mean:
        found |= warn("weight_mean", mean=mean, error=error)
    if effective == 0.0:
        return found | warn("no_failures")
    if effective < LEAST_EFFECTIVE or largest > LARGEST_SHARE:
        found |= warn("weight_degenerate", effective=effective, largest=largest)
    if surprise > LARGEST_SURPRISE or unseen >= MOST_UNSEEN:
        found |= warn("cross_check", surprise=surprise, unseen=unseen)
    return found
