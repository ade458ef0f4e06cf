"""Learned proposal with a share of the target, as one law that can be continued from the middle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.tapes.tape_mixture import NONE, TapeMixture
from avrare_estimators.common.weights import mixture_log_weights


@dataclass(frozen=True)
class DefendedMixture:
    """Law a p + (1 - a) q of a tape (a ``TapeProposal``): its weights are at most 1 / a at every step.

    Attributes:
        mixture: q.
        share: a.
    """

    mixture: TapeMixture
    share: float

    @property
    def digest(self) -> str:
        """Digits that identify it."""
        return f"{self.mixture.digest}-{self.share!r}"

    @property
    def terms(self) -> int:
        """Number of sums that the density needs."""
        return self.mixture.terms

    def choose(self, uniform: Floats, sums: Floats | None = None) -> NDArray[np.void]:
        """Return atoms and amounts (M, 2) of rows; none for rows of the target."""
        target: Floats | float = self.share
        if sums is not None:  # Bayes: a p / (a p + (1 - a) q) of the steps so far
            target = np.exp(math.log(self.share) + self.log_ratio(sums))
        other = np.maximum(1.0 - target, 2.0**-53)  # 0 where all but the target is impossible by now
        rest = uniform.copy()
        rest[:, 0] = np.clip((uniform[:, 0] - target) / other, 0.0, 1.0 - 2.0**-53)
        chosen = self.mixture.choose(rest, sums)
        chosen["atom"][uniform[:, 0] < target] = NONE
        return chosen

    def transform(self, noise: Floats, chosen: NDArray[np.void], first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""
        self.mixture.transform(noise, chosen, first)

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return the sums that a step changes, and by how much (k, M)."""
        return self.mixture.evidence(noise, step)

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p over this law (M,) from the sums over the steps."""
        return mixture_log_weights(self.mixture.log_ratio(sums), self.share)
