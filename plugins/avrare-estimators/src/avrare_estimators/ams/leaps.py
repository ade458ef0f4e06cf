"""Leaps: rollouts that come from a low level to a high one in a single step.

Splitting climbs: it copies what has come some way and lets it try again. Where one outlier decides, the way
begins anew with every try, so that only the first rollouts have a fair chance of such a failure, and runs
that met none agree with each other. At levels that the first rollouts reach this shows often enough to see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats

_BELOW, _ABOVE = 0.1, 0.01
"""Shares of the rollouts that pass the low level and the high one."""
_LEAST, _MOST_SHARE = 20, 1.0 / 3.0
"""Rollouts above the high level from which the share of leaps is judged, and the largest that is no doubt."""


@dataclass(frozen=True)
class Leaps:
    """Rollouts above the high level.

    Attributes:
        count: Those that came there in a single step from below the low level.
        rows: All of them.
    """

    count: int = 0
    rows: int = 0

    @staticmethod
    def of(scores: Floats) -> Leaps:
        """Count the leaps among the running scores (N, T + 1) of independent rollouts."""
        if not len(scores):
            return Leaps()
        low, high = np.quantile(scores[:, -1], [1.0 - _BELOW, 1.0 - _ABOVE], method="lower")
        passed = scores[scores[:, -1] > high]
        step = (passed > high).argmax(axis=1)
        before = passed[np.arange(len(passed)), np.maximum(step - 1, 0)]
        return Leaps(int(((before <= low) & (step > 0)).sum()), len(passed))

    def __add__(self, other: Leaps) -> Leaps:
        """Return both together."""
        return Leaps(self.count + other.count, self.rows + other.rows)

    @property
    def share(self) -> float:
        """Share of the leaps."""
        return self.count / max(self.rows, 1)

    @property
    def too_many(self) -> bool:
        """True if splitting cannot climb to a large part of the high level."""
        return self.rows >= _LEAST and self.share > _MOST_SHARE
