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

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, rotate

_CIRCLE = 2.0 * np.pi


@dataclass(frozen=True)
class SlopeStatistics:
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
    def empty(rows: int) -> SlopeStatistics:
        """Return the slopes of chains without any pair."""
        zeros = np.zeros(rows, dtype=np.int64)
        return SlopeStatistics(zeros, zeros, np.zeros(rows))


@dataclass(frozen=True)
class Arcs:
    """Arcs that are ruled out, of M chains after J turns.

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
    slopes: SlopeStatistics


class Elimination(Kernel):
    """Base of the kernels that eliminate; they differ in their bound on the slope."""

    rollouts = 4.0

    def tell(self, move: Move, points: Points) -> Move:
        # 1. Rejected angles rule out all within short / bound of them.
        rows, work = move.waiting, move.work
        good = points.above(move.level[rows])
        short = np.zeros((len(move.level), 1))
        finite = ~good & np.isfinite(points.score) & np.isfinite(move.level[rows])
        short[rows[finite], 0] = (move.level[rows] - points.score)[finite]
        work = replace(work, short=np.concatenate([work.short, short], axis=1))
        move, rows = move.accept(good, points), rows[~good]
        if move.turn >= 200 or not len(rows):
            return replace(move.stay(), work=work)
        # 2. Draw the next angle uniformly on what is left of the circle.
        uniforms = move.draw.uniforms(rows, move.turn)
        angle, empty = free_angle(work.tried[rows], work.short[rows] / work.bound[rows, None], uniforms)
        if empty.any():  # the bound was none
            work, angle = self._grow_bound(work, rows, empty, angle, uniforms)
        tried = np.zeros((len(move.level), 1))
        tried[rows, 0] = angle
        work = replace(work, tried=np.concatenate([work.tried, tried], axis=1))
        proposal = rotate(move.state.tape[rows], work.other[rows], angle)
        return replace(move, proposal=proposal, turn=move.turn + 1, work=work)

    @staticmethod
    def _grow_bound(
        work: Arcs, rows: Integers, empty: Bools, angle: Floats, uniforms: Floats
    ) -> tuple[Arcs, Floats]:
        bound, angle = work.bound.copy(), angle.copy()
        while empty.any():
            at = rows[empty]
            bound[at] *= 1.1
            angle[empty], still = free_angle(
                work.tried[at], work.short[at] / bound[at, None], uniforms[empty]
            )
            empty = empty.copy()
            empty[empty] = still
        return replace(work, bound=bound), angle

    @staticmethod
    def begin(state: Points, level: Floats, draw: Draw, other: Floats, bound: Floats) -> Move:
        """Return the first turn: an angle uniform on the ellipse with the axis ``other``."""
        angle = _CIRCLE * draw.uniforms(np.arange(len(level)), 0)
        arcs = Arcs(
            other, bound, angle[:, None], np.zeros((len(level), 0)), SlopeStatistics.empty(len(level))
        )
        return Move.begin(state, level, draw, rotate(state.tape, other, angle), arcs)


def free_angle(centre: Floats, half: Floats, uniforms: Floats) -> tuple[Floats, Bools]:
    """Return an angle uniform on the circle without some arcs.

    Args:
        centre: (W, J) centres of the arcs, in [0, 2 pi).
        half: (W, J) half their widths; 0 for none.
        uniforms: (W,) in (0, 1).

    Returns:
        (W,) angles, and (W,) bool: nothing is left, and the angle has no meaning.
    """
    half = np.minimum(half, np.pi)
    low = np.mod(centre - half, _CIRCLE)
    high = low + 2.0 * half
    over = np.maximum(high - _CIRCLE, 0.0)  # the part beyond 2 pi begins at 0 again
    ends = np.zeros((len(centre), 1))
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
