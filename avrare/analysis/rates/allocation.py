"""Shares of one budget: as many rollouts of each scene as make the rates' variances fall fastest."""

from __future__ import annotations

import math
from collections.abc import Sequence

from avrare.base.errors import UsageError

LEAST = 20
"""Fewest rollouts of a scene, whatever its pilot has shown."""


def allocate(
    exposures: Sequence[float],
    pilot: Sequence[Sequence[tuple[int, int] | None]],
    costs: Sequence[float],
    budget: float,
    others: Sequence[float] | None = None,
) -> list[int]:
    """Return the rollouts of each scene (Neyman 1934).

    The variance of rule r's rate is the sum over scenes of e_i^2 p_ir (1 - p_ir) / n_i. It minimises the sum
    over rules of that variance over the squared rate: n_i is proportional to the square root of
    sum_r e_i^2 p_ir (1 - p_ir) / rate_r^2, over that of the cost of a rollout.

    Args:
        exposures: e_i.
        pilot: For each scene, for each rule, failures and rollouts of the pilot; half a failure in one more
            rollout is added to each, so that no scene counts as safe because a few rollouts passed. None: an
            estimator of the scene's own estimates this rule, and the shared rollouts do not.
        costs: Cost of a rollout of each scene.
        budget: Most cost of all rollouts together.
        others: For each rule, the part of its rate that comes from estimators of the scenes' own.

    Raises:
        UsageError: The budget does not pay for ``LEAST`` rollouts of each scene.
    """
    least = LEAST * math.fsum(costs)
    if budget < least:
        text = f"the budget does not pay for {LEAST} rollouts of each of {len(costs)} scenes"
        raise UsageError(text, f"it must be at least {math.ceil(least):,} after the pilot")
    shares = [
        {r: (seen[0] + 0.5) / (seen[1] + 1.0) for r, seen in enumerate(scene) if seen is not None}
        for scene in pilot
    ]
    rates = [
        math.fsum([other, *(e * scene[r] for e, scene in zip(exposures, shares, strict=True) if r in scene)])
        for r, other in enumerate(others or [0.0] * len(pilot[0]))
    ]
    weights = [
        e * math.sqrt(math.fsum(p * (1.0 - p) / rates[r] ** 2 for r, p in scene.items()) / cost)
        for e, scene, cost in zip(exposures, shares, costs, strict=True)
    ]
    return _divide(weights, costs, budget)


def _divide(weights: Sequence[float], costs: Sequence[float], budget: float) -> list[int]:
    # Scenes whose share is below the least get it, and the others share what is left.
    fixed: set[int] = set()
    while True:
        left = budget - LEAST * math.fsum(costs[i] for i in fixed)
        open_ = [i for i in range(len(weights)) if i not in fixed]
        total = math.fsum(weights[i] * costs[i] for i in open_)
        counts = {i: math.floor(left * weights[i] / total) if total else LEAST for i in open_}
        short = {i for i, count in counts.items() if count < LEAST}
        if not short:
            return [counts.get(i, LEAST) for i in range(len(weights))]
        fixed |= short
