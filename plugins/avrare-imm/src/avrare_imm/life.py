"""Life of tracks: birth after m detections within n steps, death after misses in a row, and restarts."""

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
        rejections: (N, V) detections beyond the gate since one was accepted.
    """

    exists: Bools
    detections: Bits
    rejections: Bits


@dataclass(frozen=True)
class LifeRules:
    """Rules for the begin and the end of tracks.

    Attributes:
        least: Detections that make a track ...
        of: ... within so many steps.
        misses: Misses in a row that end one; None: it never ends.
        restart: Detections beyond the gate, none accepted between them, with which one begins anew; None:
            it does not.
    """

    least: int
    of: int
    misses: int | None
    restart: int | None = None

    def none(self, shape: tuple[int, ...]) -> Life:
        """Return vehicles (N, V) without tracks."""
        return Life(np.zeros(shape, bool), np.zeros(shape, np.int64), np.zeros(shape, np.int64))

    def all(self, shape: tuple[int, ...]) -> Life:
        """Return vehicles (N, V) with tracks, as if detected without a miss."""
        detections = np.full(shape, self._last(max(self.of, self.misses or 1)))
        return Life(np.ones(shape, bool), detections, np.zeros(shape, np.int64))

    def absent(self, life: Life) -> Bools:
        """Return a mask (N, V) of the vehicles without even a tentative track."""
        return np.asarray(~life.exists & (life.detections == 0))

    def restarts(self, life: Life, rejected: Bools) -> Bools:
        """Return (N, V) which tracks restart at a detection beyond their gate."""
        if self.restart is None:
            return np.zeros_like(rejected)
        return np.asarray(rejected & (life.rejections + 1 >= self.restart))

    def update(self, life: Life, accepted: Bools, rejected: Bools) -> Life:
        """Return the life one step later, after the detections (N, V) that were accepted and the others."""
        detections = (life.detections << 1 | accepted) & self._last(max(self.of, self.misses or 1))
        hits = sum((detections >> k) & 1 for k in range(self.of))
        lost = np.zeros_like(accepted)
        if self.misses is not None:
            lost = life.exists & (detections & self._last(self.misses) == 0)
        exists = (life.exists & ~lost) | (~life.exists & (hits >= self.least))
        detections = np.where(exists, detections, detections & self._last(self.of))
        rejections = np.where(accepted | lost, 0, life.rejections + rejected)
        return Life(exists, np.where(lost, 0, detections), rejections)

    @staticmethod
    def _last(steps: int) -> int:
        return (1 << steps) - 1
