"""Health warnings of these estimators."""

from __future__ import annotations

WARNINGS = {
    "extinct": "all {runs} runs died out before they reached a failure: only the upper bound from "
    "their first rollouts is known; use more particles or fewer discards (in `ess`, more chains)",
    "few_roots": "the failures of {runs} runs, of which {extinct} died out and count as 0, descend from only "
    "{roots} first particles: use more particles or fewer discards (in `ess`, more chains)",
    "leaps": "{share:.0%} of the first rollouts that pass the level of 1 % come from below that of 10 % in a "
    "single step: splitting cannot climb towards failures that one outlier decides, and runs that have met "
    "none of them agree on too low a probability; compare with `ess`, `mc`, or `is` with a learned proposal",
    "no_failures": "no rollout failed: the proposal does not reach a failure, and the probability is known "
    "only to lie below the upper end of the interval; use more rollouts, or mc",
    "weight_degenerate": "{reason}: the interval is opened to hold for any weights; use more rollouts, a "
    "larger `defensive`, or a proposal closer to the failures",
    "heuristic_kernel": "{note}",
}
"""Name to text."""
