"""Agreement of the stages of learning with the sample that counts."""

from __future__ import annotations

import math
from collections.abc import Sequence

from avrare.base.number_format import format_probability
from avrare.base.special_functions import t_factor
from avrare_estimators.common import health
from avrare_estimators.common.samples.sampling import Sample, failing_weights
from avrare_estimators.common.weights import effective_size, stratified_variance

_LEAST_EFFECTIVE = 15.0


def find_differing(samples: Sequence[Sample], mean: float, variance: float) -> dict[str, str]:
    """Return the warning that stages contradict the final estimate.

    Args:
        samples: Samples of the stages.
        mean: Final estimate.
        variance: Its relative variance.
    """
    estimates = [estimate for sample in samples if (estimate := _estimate(sample))[2] >= _LEAST_EFFECTIVE]
    if not estimates or not mean:
        return {}
    confidence = 1.0 - 1e-3 / len(estimates)  # the risk that stages which agree seem not to
    contradicting = [
        format_probability(value)
        for value, spread, effective in estimates
        if abs(math.log(value / mean))
        > t_factor(confidence, int(effective) - 1) * math.sqrt(math.log1p(spread) + math.log1p(variance))
    ]
    if not contradicting:
        return {}
    reason = f"stages of learning estimate {', '.join(contradicting)} but {format_probability(mean)}"
    return health.warn("contradicted", reason=reason)


def _estimate(sample: Sample) -> tuple[float, float, float]:
    """Return a sample's estimate, its relative variance, and its effective number of failures."""
    values = failing_weights(sample)
    mean = float(values.mean())
    if not mean:
        return 0.0, math.inf, 0.0
    return mean, stratified_variance(values / mean, sample.target_rows), effective_size(values)
