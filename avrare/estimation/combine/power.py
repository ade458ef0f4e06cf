"""Power of a witness: the chance that it would have noticed a miss of the estimate beside it."""

from __future__ import annotations

import math
from statistics import NormalDist

MISS = 3.0
"""Factor of a miss that a witness must be able to notice."""
LEAST_POWER = 0.5
"""Power below which agreement says nothing: then a miss would mostly have passed as agreement."""


def power_to_notice(threshold: float, errors: tuple[float, float]) -> float:
    """Return the chance that two estimates would have disagreed if they were apart by the factor of a miss.

    Args:
        threshold: Factor between the estimates from which they disagree.
        errors: Their relative errors; NaN where one has found nothing.
    """
    spread = math.sqrt(sum(math.log1p(error**2) for error in errors))
    if not spread or math.isnan(spread) or not math.isfinite(threshold):
        return 0.0
    return NormalDist().cdf((math.log(MISS) - math.log(threshold)) / spread)


def describe_power(power: float) -> str:
    """Return the power in words."""
    return f"a miss by a factor {MISS:g} would have been noticed in {100 * power:.0f} of 100"
