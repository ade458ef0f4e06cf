"""Elimination with a given bound on the slope of the score, which pairs of tapes may refute."""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

from dataclasses import replace

import numpy as np

from avrare.protocols import Floats
from avrare_estimators.common import health
from avrare_estimators.common.chains.kernel import Draw, Move, Points, StepOutcome
from avrare_estimators.ess.kernels.elimination import Elimination, SlopeStatistics


class LipschitzKernel(Elimination):
    """Valid where ``slope`` bounds the score's slope per unit of Euclidean length of the tape.

    On an ellipse with axes a and b the tape moves by at most the largest singular value of (a, b) per radian.
    No sample proves a bound, but a pair of tapes can refute one: the tuning are the slopes met.
    """

    name = "lipschitz"

    def __init__(self, slope: float) -> None:
        self.slope = slope

    def init(self, runs: int) -> SlopeStatistics:
        return SlopeStatistics.empty(runs)

    def start(self, tuning: object, state: Points, level: Floats, draw: Draw) -> Move:
        other = draw.tapes()
        return self.begin(state, level, draw, other, self.slope * _largest_singular_value(state.tape, other))

    def tell(self, move: Move, points: Points) -> Move:
        rows, state, old = move.waiting, move.state, move.work.slopes
        apart = points.tape - state.tape[rows]
        length = np.sqrt(_dot(apart, apart))
        comparable = (length > 0.0) & np.isfinite(points.score) & np.isfinite(state.score[rows])
        new, here = np.where(comparable, points.score, 0.0), np.where(comparable, state.score[rows], 0.0)
        rounding = 1e-9  # relative difference of two scores below which it is rounding
        rise = np.maximum(np.abs(new - here) - rounding * (np.abs(new) + np.abs(here)), 0.0)
        slope = rise / np.where(comparable, length, 1.0)
        pairs, steep, most = old.pairs.copy(), old.steep.copy(), old.most.copy()
        pairs[rows] += comparable
        steep[rows] += slope > self.slope
        most[rows] = np.maximum(most[rows], slope)
        work = replace(move.work, slopes=SlopeStatistics(pairs, steep, most))
        return super().tell(replace(move, work=work), points)

    def watch(self, tuning: SlopeStatistics, outcome: StepOutcome) -> SlopeStatistics:
        pairs, steep, most = tuning.pairs.copy(), tuning.steep.copy(), tuning.most.copy()
        np.add.at(pairs, outcome.run, outcome.work.slopes.pairs)
        np.add.at(steep, outcome.run, outcome.work.slopes.steep)
        np.maximum.at(most, outcome.run, outcome.work.slopes.most)
        return SlopeStatistics(pairs, steep, most)

    def warnings(self, tuning: SlopeStatistics) -> dict[str, str]:
        steep, pairs = int(tuning.steep.sum()), int(tuning.pairs.sum())
        if not steep:
            return {}
        note = (
            f"{steep} of {pairs} pairs of tapes differ by more than bound: {self.slope:g} allows, by up to "
            f"{tuning.most.max():.3g} per unit of length: it is not a bound, and the estimate may be biased; "
            "raise it, or use kernel shrink"
        )
        return health.warn("heuristic_kernel", note=note)


def _largest_singular_value(a: Floats, b: Floats) -> Floats:
    aa, bb, ab = (_dot(x, y) for x, y in ((a, a), (b, b), (a, b)))
    return np.asarray(np.sqrt(0.5 * (aa + bb + np.hypot(aa - bb, 2.0 * ab))))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).reshape(len(a), -1).sum(axis=1))
