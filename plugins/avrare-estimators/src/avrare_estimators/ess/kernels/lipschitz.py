"""Slices of an ellipse by elimination (stl-ess, Algorithm 2): angles that a bound rules out are not tried.

A rejected angle whose score lies d below the level rules out all angles within d / M of it, if M bounds the
slope of the score along the ellipse. The first angle inside the set is then uniform on all such angles. That
needs M to be a true bound, and no failures at scores below the level. An M that grows only once nothing is
left, as in the paper, need not be a bound: it rules out angles of the set, but none near the chain's own, and
chains drift into failure.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators import health
from avrare_estimators.ess.chains import Draw, Kernel, Move, Points, StepOutcome, rotated

_CIRCLE = 2.0 * np.pi
_MOST_TURNS = 200
_GROWTH = 1.1
_ROUNDING = 1e-9
"""Relative difference of two scores below which it is rounding."""


@dataclass(frozen=True)
class _SlopeStatistics:
    """Slopes of the score between proposals and their chains' own tapes, of M chains or R runs.

    Attributes:
        pairs: (M,) number of pairs.
        steep: (M,) pairs that are steeper than the bound.
        most: (M,) the steepest slope, score per unit of length of the tape.
    """

    pairs: Integers
    steep: Integers
    most: Floats

    @staticmethod
    def empty(rows: int) -> _SlopeStatistics:
        zeros = np.zeros(rows, dtype=np.int64)
        return _SlopeStatistics(zeros, zeros, np.zeros(rows))


@dataclass(frozen=True)
class _Arcs:
    """_Arcs that are ruled out, of M chains after J turns.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        bound: (M,) bound on the slope, score per radian.
        tried: (M, J) angles tried.
        short: (M, J) distance of their scores below the level; 0 rules out nothing.
        slopes: Statistics of the slopes met.
    """

    other: Floats
    bound: Floats
    tried: Floats
    short: Floats
    slopes: _SlopeStatistics


class _Elimination(Kernel):
    rollouts = 4.0

    def tell(self, move: Move, found: Points) -> Move:
        # 1. Rejected angles rule out all within short / bound of them.
        rows, work = move.waiting, move.work
        good = found.above(move.level[rows])
        short = np.zeros((len(move.level), 1))
        known = ~good & np.isfinite(found.score) & np.isfinite(move.level[rows])
        short[rows[known], 0] = (move.level[rows] - found.score)[known]
        work = replace(work, short=np.concatenate([work.short, short], axis=1))
        move, rows = move.accept(good, found), rows[~good]
        if move.turn >= _MOST_TURNS or not len(rows):
            return replace(move.stay(), work=work)
        # 2. Draw the next angle uniformly on what is left of the circle.
        uniforms = move.draw.uniforms(rows, move.turn)
        angle, empty = free_angle(work.tried[rows], work.short[rows] / work.bound[rows, None], uniforms)
        if empty.any():  # the bound was none
            work, angle = self._grow_bound(work, rows, empty, angle, uniforms)
        tried = np.zeros((len(move.level), 1))
        tried[rows, 0] = angle
        work = replace(work, tried=np.concatenate([work.tried, tried], axis=1))
        proposal = rotated(move.state.tape[rows], work.other[rows], angle)
        return replace(move, proposal=proposal, turn=move.turn + 1, work=work)

    @staticmethod
    def _grow_bound(
        work: _Arcs, rows: Integers, empty: Bools, angle: Floats, uniforms: Floats
    ) -> tuple[_Arcs, Floats]:
        bound, angle = work.bound.copy(), angle.copy()
        while empty.any():
            at = rows[empty]
            bound[at] *= _GROWTH
            angle[empty], still = free_angle(
                work.tried[at], work.short[at] / bound[at, None], uniforms[empty]
            )
            empty = empty.copy()
            empty[empty] = still
        return replace(work, bound=bound), angle

    @staticmethod
    def _first(state: Points, level: Floats, draw: Draw, other: Floats, bound: Floats) -> Move:
        angle = _CIRCLE * draw.uniforms(np.arange(len(level)), 0)
        arcs = _Arcs(
            other, bound, angle[:, None], np.zeros((len(level), 0)), _SlopeStatistics.empty(len(level))
        )
        return Move.begin(state, level, draw, rotated(state.tape, other, angle), arcs)


class LipschitzKernel(_Elimination):
    """Valid where ``slope`` bounds the score's slope per unit of Euclidean length of the tape.

    On an ellipse with axes a and b the tape moves by at most the largest singular value of (a, b) per radian.
    No sample proves a bound, but a pair of tapes can refute one: ``known`` are the slopes met.
    """

    def __init__(self, slope: float) -> None:
        self.slope = slope

    def init(self, runs: int) -> _SlopeStatistics:
        return _SlopeStatistics.empty(runs)

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        other = draw.tapes()
        return self._first(state, level, draw, other, self.slope * _largest_singular_value(state.tape, other))

    def tell(self, move: Move, found: Points) -> Move:
        rows, own, old = move.waiting, move.state, move.work.slopes
        apart = found.tape - own.tape[rows]
        length = np.sqrt(_dot(apart, apart))
        known = (length > 0.0) & np.isfinite(found.score) & np.isfinite(own.score[rows])
        new, here = np.where(known, found.score, 0.0), np.where(known, own.score[rows], 0.0)
        rise = np.maximum(np.abs(new - here) - _ROUNDING * (np.abs(new) + np.abs(here)), 0.0)
        slope = rise / np.where(known, length, 1.0)
        pairs, steep, most = old.pairs.copy(), old.steep.copy(), old.most.copy()
        pairs[rows] += known
        steep[rows] += slope > self.slope
        most[rows] = np.maximum(most[rows], slope)
        work = replace(move.work, slopes=_SlopeStatistics(pairs, steep, most))
        return super().tell(replace(move, work=work), found)

    def watch(self, known: _SlopeStatistics, outcome: StepOutcome) -> _SlopeStatistics:
        pairs, steep, most = known.pairs.copy(), known.steep.copy(), known.most.copy()
        np.add.at(pairs, outcome.run, outcome.work.slopes.pairs)
        np.add.at(steep, outcome.run, outcome.work.slopes.steep)
        np.maximum.at(most, outcome.run, outcome.work.slopes.most)
        return _SlopeStatistics(pairs, steep, most)

    def warnings(self, known: _SlopeStatistics) -> dict[str, str]:
        steep, pairs = int(known.steep.sum()), int(known.pairs.sum())
        if not steep:
            return {}
        return health.warn(
            "lipschitz_exceeded", steep=steep, pairs=pairs, slope=self.slope, most=known.most.max()
        )


class GrowingLipschitzKernel(_Elimination):
    """The paper's kernel: one slope per radian for all ellipses of a run, a guess that grows. Biased.

    ``known`` is the bound (R,) on the slope, score per radian.
    """

    note = (
        "kernel lipschitz_growing is a heuristic: its guess of the slope may rule out parts of the level's "
        "set, and the estimate is biased, mostly upwards"
    )

    def __init__(self, guess: float) -> None:
        self.guess = guess

    def init(self, runs: int) -> Floats:
        return np.full(runs, self.guess)

    def start(self, known: Floats, state: Points, level: Floats, draw: Draw) -> Move:
        return self._first(state, level, draw, draw.tapes(), known)

    def adapt(self, known: Floats, outcome: StepOutcome) -> Floats:
        bound = known.copy()
        np.maximum.at(bound, outcome.run, outcome.work.bound)
        return bound


def free_angle(center: Floats, half: Floats, uniforms: Floats) -> tuple[Floats, Bools]:
    """Return an angle uniform on the circle without some arcs.

    Args:
        center: (W, J) centres of the arcs, in [0, 2 pi).
        half: (W, J) half their widths; 0 for none.
        uniforms: (W,) in (0, 1).

    Returns:
        (W,) angles, and (W,) bool: nothing is left, and the angle has no meaning.
    """
    half = np.minimum(half, np.pi)
    low = np.mod(center - half, _CIRCLE)
    high = low + 2.0 * half
    over = np.maximum(high - _CIRCLE, 0.0)  # the part beyond 2 pi begins at 0 again
    ends = np.zeros((len(center), 1))
    start = np.concatenate([low, np.zeros_like(low), ends + _CIRCLE], axis=1)
    stop = np.concatenate([np.minimum(high, _CIRCLE), over, ends + _CIRCLE], axis=1)
    order = np.argsort(start, axis=1, kind="stable")
    start, stop = np.take_along_axis(start, order, axis=1), np.take_along_axis(stop, order, axis=1)
    covered = np.concatenate([ends, np.maximum.accumulate(stop, axis=1)[:, :-1]], axis=1)
    total = np.cumsum(np.maximum(start - covered, 0.0), axis=1)
    place = uniforms * total[:, -1]
    gap = np.minimum((total <= place[:, None]).sum(axis=1), total.shape[1] - 1)[:, None]
    # Measured from the gap's end: the sum up to it is known.
    angle = np.take_along_axis(start, gap, axis=1) - (np.take_along_axis(total, gap, axis=1) - place[:, None])
    return angle[:, 0], total[:, -1] <= 0.0


def _largest_singular_value(a: Floats, b: Floats) -> Floats:
    aa, bb, ab = (_dot(x, y) for x, y in ((a, a), (b, b), (a, b)))
    return np.asarray(np.sqrt(0.5 * (aa + bb + np.hypot(aa - bb, 2.0 * ab))))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).reshape(len(a), -1).sum(axis=1))
