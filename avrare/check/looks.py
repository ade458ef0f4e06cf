"""When to look: once, or again after each part of what may be spent."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.estimation.budget import Budget

SHARES = (0.125, 0.125, 0.25, 0.5)
"""Of the budget that each look adds, doubling what there was; and of the error rate that it spends."""
_STRIDE = 0x9E3779B97F4A7C15
_SEEDS = 2**63


@dataclass(frozen=True)
class Stage:
    """A look and what is drawn for it.

    Attributes:
        number: 1 for the first.
        share: Of the error rate.
        budget: Of each estimate; None: the estimator's own options decide.
    """

    number: int
    share: float
    budget: Budget | None

    def seed(self, seed: int) -> int:
        """Its own: what a look draws is independent of all others."""
        return (seed + (self.number - 1) * _STRIDE) % _SEEDS


def stages(budget: Budget | None, spend: Budget | None) -> list[Stage]:
    """The looks that are planned.

    Args:
        budget: Of a single look.
        spend: Of all looks together, where there may be several.
    """
    if spend is None:
        return [Stage(1, 1.0, budget)]
    return [
        Stage(number, share, Budget(spend.kind, spend.amount * share))
        for number, share in enumerate(SHARES, 1)
    ]
