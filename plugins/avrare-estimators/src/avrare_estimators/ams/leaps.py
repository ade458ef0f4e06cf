"""Leaps: rollouts that come from a low level to a high one in a single step.

Splitting climbs: it copies particles that have come some way and lets them try again. Where one outlier
decides, the way begins anew with every try, so that only the first rollouts have a fair chance to fail so,
and runs that met no failure agree with each other. Leaps can be counted at levels that the first rollouts
reach.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from avrare.protocols import Floats

_BELOW, _BETWEEN, _ABOVE = 0.1, 0.05, 0.01
"""Shares of the rollouts that pass the low level, one between, and the high one."""
_LEAST, _MOST_SHARE = 20, 1.0 / 3.0
"""Fewest rollouts above the high level to judge the leaps, and their largest share without a warning."""


def _empty() -> Floats:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Leaps:
    """Kept part of M independent rollouts: the levels are those of all, the rollouts come in batches.

    A leap passes every level between the low one and the high one in the same step: that at which a rollout
    passes a level between them, such as its batch's own. Of batches of fewer than 50, whose own level may lie
    outside, a few leaps can be missed.

    Attributes:
        final: (M,) score at the end.
        before: (H,) score before that step, of the H rollouts that come so far; infinite at the start.
        after: (H,) score after it.
    """

    final: Floats = field(default_factory=_empty)
    before: Floats = field(default_factory=_empty)
    after: Floats = field(default_factory=_empty)

    @staticmethod
    def of(scores: Floats) -> Leaps:
        """Return the leaps of a batch of independent rollouts from their running scores (N, T + 1)."""
        if not len(scores):
            return Leaps()
        final = scores[:, -1].copy()
        between = np.quantile(final, 1.0 - _BETWEEN, method="lower")
        passed = scores[final > between]
        step, row = (passed > between).argmax(axis=1), np.arange(len(passed))
        before = np.where(step > 0, passed[row, np.maximum(step - 1, 0)], np.inf)
        return Leaps(final, before, passed[row, step])

    def __add__(self, other: Leaps) -> Leaps:
        """Return both together."""
        pairs = ((getattr(self, array.name), getattr(other, array.name)) for array in fields(self))
        return Leaps(*map(np.concatenate, pairs))

    @cached_property
    def rows(self) -> int:
        """Rollouts above the high level."""
        return int((self.final > self._levels[1]).sum())

    @cached_property
    def count(self) -> int:
        """Rollouts above the high level that came there in a single step from below the low one."""
        low, high = self._levels
        return int(((self.before <= low) & (self.after > high)).sum())

    @property
    def share(self) -> float:
        """Share of the leaps."""
        return self.count / max(self.rows, 1)

    @property
    def too_many(self) -> bool:
        """True if splitting cannot climb to a large part of the high level."""
        return self.rows >= _LEAST and self.share > _MOST_SHARE

    @cached_property
    def _levels(self) -> tuple[float, float]:
        if not len(self.final):
            return np.inf, np.inf
        low, high = np.quantile(self.final, [1.0 - _BELOW, 1.0 - _ABOVE], method="lower")
        return float(low), float(high)
