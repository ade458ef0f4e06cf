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


def find_doubts(
    mean: float, own: Interval, checks: Sequence[CrossCheckResult | None], confidence: float
) -> dict[str, str]:
    """Return the warning that the estimate is contradicted, or that nothing vouches for it.

    Args:
        mean: Weighted estimate, above 0.
        own: Interval by the weights.
        checks: Cross-check of each run, None where there was none; empty if none was asked for.
        confidence: Level of the intervals.
    """
    if not checks:
        return {}
    done = [check for check in checks if check is not None and check.probabilities]
    if 2 * len(done) <= len(checks):
        return health.warn("unchecked", reason="the cross-check did not reach a failure within its rollouts")
    values = np.concatenate([check.probabilities for check in done])
    found = float(values.mean())
    if found == 0.0:
        return health.warn("unchecked", reason="the cross-check died out before it reached a failure")
    variance = float((values / found).var(ddof=1)) / len(values)
    checked = intervals.log_normal(found, variance, confidence, freedom=len(values) - 1)
    says = f"the cross-check says {format_estimate(found, checked)}"
    # It has few rows to start from and mostly errs low, whereas the sample counts failures that it holds, by
    # weights that are even (else ``weight_degenerate``): a check that is somewhat lower contradicts nothing.
    if checked[0] > own[1] or (checked[1] < own[0] and found * WIDEST < mean):
        sample = f"the weighted sample says {format_estimate(mean, own)}"
        return health.warn("contradicted", reason=f"{says}, but {sample}")
    if checked[1] > WIDEST * found:
        return health.warn("unchecked", reason=f"{says}, which is too wide to vouch for the estimate")
    return {}
