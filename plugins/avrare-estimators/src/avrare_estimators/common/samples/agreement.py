"""Agreement of a weighted estimate with rollouts that do not depend on its proposal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from avrare.base.number_format import format_estimate
from avrare.estimation.combine.witnesses import LEAST_POWER, MISS, describe_power, power_to_notice
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.note import Note
from avrare_estimators.common import health
from avrare_estimators.common.samples.cross_check import CrossCheckResult


def compare_checks(
    mean: float, sampled: Interval, error: float, checks: Sequence[CrossCheckResult | None], confidence: float
) -> tuple[dict[str, str], tuple[Note, ...]]:
    """Return the warning that the estimate is contradicted or has no witness, or the note on its witness.

    Args:
        mean: Weighted estimate, above 0.
        sampled: Interval by the weights.
        error: Its relative error.
        checks: Cross-check of each run, None where there was none; empty if none was asked for.
        confidence: Level of the intervals.
    """
    if not checks:
        return {}, ()
    done = [check for check in checks if check is not None and check.probabilities]
    if 2 * len(done) <= len(checks):
        reason = "the cross-check did not reach a failure within its rollouts"
        return health.warn("unchecked", reason=reason), ()
    values = np.concatenate([check.probabilities for check in done])
    check_mean = float(values.mean())
    if check_mean == 0.0:
        reason = "the cross-check died out before it reached a failure"
        return health.warn("unchecked", reason=reason), ()
    variance = float((values / check_mean).var(ddof=1)) / len(values)
    checked = intervals.log_normal(check_mean, variance, confidence, freedom=len(values) - 1)
    says = f"the cross-check says {format_estimate(check_mean, checked)}"
    # It has few rows to start from and mostly errs low, whereas the sample counts failures that it holds, by
    # weights that are even (else ``weight_degenerate``): a check that is somewhat lower contradicts nothing.
    if checked[0] > sampled[1] or (checked[1] < sampled[0] and check_mean * MISS < mean):
        sample = f"the weighted sample says {format_estimate(mean, sampled)}"
        return health.warn("contradicted", reason=f"{says}, but {sample}"), ()
    threshold = sampled[1] / mean * check_mean / checked[0] if checked[0] else math.inf
    power = power_to_notice(threshold, (error, math.sqrt(variance)))
    if power < LEAST_POWER:
        reason = f"{says}, which vouches for little: {describe_power(power)}"
        return health.warn("unchecked", reason=reason), ()
    return {}, (Note("witness", f"{says[0].upper()}{says[1:]}: {describe_power(power)}."),)
