"""Agreement of a weighted estimate with rollouts that do not depend on its proposal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.base.number_format import format_estimate
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare_estimators.common import health
from avrare_estimators.common.samples.cross_check import CrossCheckResult

WIDEST = 3.0
"""Factor up to which a cross-check vouches: upper end over estimate, another estimate over its own."""
MOST_UNSEEN = 0.5


def find_doubts(
    mean: float,
    own: Interval,
    missed: float,
    checks: Sequence[CrossCheckResult | None],
    confidence: float,
) -> dict[str, str]:
    """Return the warning that the estimate is contradicted, or that nothing vouches for it.

    Args:
        mean: Weighted estimate, above 0.
        own: Interval by the weights.
        missed: Probability of failures that the sample may miss, as far as the cross-check knows.
        checks: Cross-check of each run, None where it did not reach failure; empty if none was asked for.
        confidence: Level of the intervals.
    """
    sample = f"the weighted sample says {format_estimate(mean, own)}"
    most = own[0], own[1] + missed
    # 1. A climb does not use the proposal, and is right as far as its groups agree.
    if not checks:
        return {}
    done = [check for check in checks if check is not None]
    if 2 * len(done) <= len(checks):
        return health.warn("unchecked", reason="the cross-check did not reach a failure within its rollouts")
    values = np.concatenate([check.probabilities for check in done])
    found = float(values.mean())
    if found == 0.0:
        return health.warn("unchecked", reason="the cross-check died out before it reached a failure")
    variance = float((values / found).var(ddof=1)) / len(values)
    climbed = intervals.log_normal(found, variance, confidence, freedom=len(values) - 1)
    says = f"the cross-check says {format_estimate(found, climbed)}"
    # It has few rows to start from and mostly errs low, whereas the sample counts failures that it holds, by
    # weights that are even (else ``weight_degenerate``): a climb that is somewhat lower contradicts nothing.
    if climbed[0] > most[1] or (climbed[1] < most[0] and found * WIDEST < mean):
        return health.warn("contradicted", reason=f"{says}, but {sample}")
    # 2. Failures that it finds must be among those of the sample.
    unseen = float((values * np.concatenate([check.unseen for check in done])).mean()) / found
    if unseen >= MOST_UNSEEN:
        more = f"{unseen:.0%} of its failures weigh more than any of the sample"
        return health.warn("contradicted", reason=f"{says}, and {more}, but {sample}")
    if any(check.lost_scouts for check in done):
        return health.warn(
            "unchecked", reason="the cross-check misses failures to which those of the sample lead"
        )
    if climbed[1] > WIDEST * found:
        return health.warn("unchecked", reason=f"{says}, which is too wide to vouch for the estimate")
    return {}


def missed_probability(mean: float, checks: Sequence[CrossCheckResult | None], confidence: float) -> float:
    """Return an upper bound for the failures that the sample does not know, as far as the cross-checks say.

    It follows from the scatter of the groups; where none has found such a failure, from the number of target
    rows that their failures descend from. It is 0 where no cross-check has an answer.
    """
    done = [check for check in checks if check is not None]
    roots = sum(check.roots for check in done)
    if not roots:
        return 0.0
    share = intervals.clopper_pearson(0, roots, confidence)[1]
    least = mean * share / (1.0 - share)
    values = np.concatenate([np.multiply(check.probabilities, check.unseen) for check in done])
    unseen = float(values.mean())
    if unseen == 0.0:
        return least
    variance = float((values / unseen).var(ddof=1)) / len(values)
    return max(least, intervals.log_normal(unseen, variance, confidence, freedom=len(values) - 1)[1])
