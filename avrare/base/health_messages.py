"""Health warnings that the core raises, or any estimator may raise, by name.

A plugin declares its own in the description of a component (``avrare.plugin.Component.warnings``).
"""

from __future__ import annotations

from collections.abc import Mapping

MESSAGES = {
    "errors": "{errors} of {rollouts} rollouts ended in an error, more than {allowed:.1%} allowed: {message}",
    "flat_part": "`{part}` is kept by the same margin in every rollout tried: nothing shows how near its "
    "failures are, and they could be as likely as {bound:.2g}; use more first rollouts, which lower this "
    "bound, or a score function that rises on the way there",
    "unchecked": "{reason}: missed failures cannot be ruled out, and the interval is widened to hold "
    "whatever is missed; use more rollouts, or compare with another estimator",
    "outliers": "failures that begin with {what} {when} have a probability of at least {low:.2g}, and the "
    "estimate's interval ends at {upper:.2g}: it misses them; use mc, more first rollouts, or "
    "importance sampling with a learned proposal",
    "horizon_short": "the formula looks {horizon} samples ahead but a rollout ends after {steps}: windows "
    "are clipped at its last sample",
    "solver_failures": "{fallbacks} of {solves} solves of the controller failed: it reused its last plan",
    "not_deterministic": "{reason}: the system depends on more than its noise, and this result cannot be "
    "reproduced",
    "rounding": "{reason}: rounding depends on the batch; the estimate is sound, but a replay may differ in "
    "the last digits",
    "all_failed": "every rollout failed: the scenario cannot show how rare failures are",
    "single_run": "only one run: its interval relies on its genealogy and is too narrow for rare events",
    "contradicted": "{reason}: at least one of them misses failures, and the interval is opened as far as "
    "the rollouts drawn from the target allow; use mc, or repeat both with more rollouts or another score",
    "model_unknown": "a member of the ensemble met no failure: its part of the interval is a rough one; use "
    "more rollouts",
}


def fill(texts: Mapping[str, str], name: str, **values: object) -> dict[str, str]:
    """Return the warning ``name`` with its text, filled in with the values."""
    return {name: texts[name].format(**values)}
