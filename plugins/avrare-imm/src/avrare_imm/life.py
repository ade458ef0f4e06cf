"""Life of tracks: birth after m detections within n steps, death after misses in a row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools

Bits = NDArray[np.int64]


@dataclass(frozen=True)
class Life:
    """Existence of V tracks for N particles.

    Attributes:
        exists: (N, V) whether the vehicle has a track; one without may have a tentative one.
        detections: (N, V) latest steps as bits, the newest lowest: 1 where a detection was accepted.
    """

    exists: Bools
    detections: Bits


@dataclass(frozen=True)
class LifeRules:
    """Rules by which tracks begin and end.

    Attributes:
        least: Detections that make a track ...
        of: ... within so many steps.
        misses: Misses in a row that end one; None: it never ends.
    """

    least: int
    of: int
    misses: int | None

    def none(self, shape: tuple[int, ...]) -> Life:
        """Return vehicles (N, V) without tracks."""
        return Life(np.zeros(shape, bool), np.zeros(shape, np.int64))

    def all(self, shape: tuple[int, ...]) -> Life:
        """Return vehicles (N, V) with tracks, as if detected without a miss."""
        return Life(np.ones(shape, bool), np.full(shape, self._last(max(self.of, self.misses or 1))))

    def absent(self, life: Life) -> Bools:
        """Tell (N, V) which vehicles have not even a tentative track."""
        return np.asarray(~life.exists & (life.detections == 0))

    def update(self, life: Life, accepted: Bools) -> Life:
        """Return the life one step later, after the detections (N, V) that were accepted."""
        detections = (life.detections << 1 | accepted) & self._last(max(self.of, self.misses or 1))
        hits = sum((detections >> k) & 1 for k in range(self.of))
        lost = np.zeros_like(accepted)
        if self.misses is not None:
            lost = life.exists & (detections & self._last(self.misses) == 0)
        exists = (life.exists & ~lost) | (~life.exists & (hits >= self.least))
        detections = np.where(exists, detections, detections & self._last(self.of))
        return Life(exists, np.where(lost, 0, detections))

    @staticmethod
    def _last(steps: int) -> int:
        return (1 << steps) - 1
