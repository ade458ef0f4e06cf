"""Health: what should make a reader doubt a number, by name."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median, pstdev

MESSAGES = {
    "errors": "{errors} of {rollouts} rollouts broke down, more than the {allowed:.1%} allowed: {message}",
    "extinct": "all {runs} runs died out before they reached a failure: the probability may be anything; "
    "use more particles or fewer discards",
    "extinct_runs": "{extinct} of {runs} runs died out and count as 0; use more particles or fewer discards",
    "single_run": "one run only: its interval rests on its genealogy and is too narrow for rare events",
    "few_roots": "half of the runs descend from fewer than {least} first particles: use more particles",
    "scattered_runs": "the runs' relative standard deviation is {spread:.2f}: use more particles",
    "all_failed": "every rollout failed: the scenario tells nothing about how often",
}
FEWEST_ROOTS = 5
LARGEST_SPREAD = 0.7


def warn(name: str, **values: object) -> dict[str, str]:
    """One named warning with its message filled in."""
    return {name: MESSAGES[name].format(**values)}


def of_errors(errors: int, rollouts: int, allowed: float, messages: Sequence[str]) -> dict[str, str]:
    """Warns when more than the allowed share of rollouts broke down."""
    if errors <= allowed * rollouts:
        return {}
    return warn(
        "errors", errors=errors, rollouts=rollouts, allowed=allowed, message="; ".join(messages[:2]) or "?"
    )


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
