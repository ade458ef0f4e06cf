"""Outcome of independent groups of chains."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from avrare.estimation.result.result import Failures
from avrare.protocols import Floats


@dataclass(frozen=True)
class Groups:
    """Groups that are done.

    Attributes:
        values: (R,) estimate of each.
        entered: (R,) probability to enter of each.
        roots: Rows of the sample that each group's failures descend from.
        errors: (R,) weight of the rollouts that broke down.
        rollouts: Rollouts of the chains.
        failures: Some failures of each group that has any.
    """

    values: Floats = field(default_factory=lambda: np.zeros(0))
    entered: Floats = field(default_factory=lambda: np.zeros(0))
    roots: tuple[int, ...] = ()
    errors: Floats = field(default_factory=lambda: np.zeros(0))
    rollouts: int = 0
    failures: tuple[Failures, ...] = ()

    def __add__(self, other: Groups) -> Groups:
        """Pool the groups of two batches."""
        return Groups(
            np.concatenate([self.values, other.values]),
            np.concatenate([self.entered, other.entered]),
            (*self.roots, *other.roots),
            np.concatenate([self.errors, other.errors]),
            self.rollouts + other.rollouts,
            (*self.failures, *other.failures),
        )

    @property
    def mean(self) -> float:
        """Estimate of the failure probability."""
        return float(self.values.mean())

    def variance(self, unit: float) -> float:
        """Return the variance of the mean in units of ``unit``."""
        return float((self.values / unit).var(ddof=1)) / len(self.values)
