"""Slices of an ellipse by elimination (stl-ess, Algorithm 2).

What a bound on the slope of the score rules out is not tried.

A rejected angle whose score lies d below the level rules out all angles within d / M of it, if M bounds the
slope of the score along the ellipse. The first angle that is good is then uniform on all good ones. That
needs M to be a true bound, and no failures at scores below the level. An M that grows only once nothing is
left, as in the paper, need not be one: it rules out good angles, but none near the chain's own, and drifts
into failure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.estimation import health
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.chains import Draw, Info, Move, Points, Untaught, rotated

_CIRCLE = 2.0 * np.pi
_MOST_TURNS = 200
_GROWTH = 1.1
_ROUNDING = 1e-9
"""Of the size of two scores: a difference as small tells nothing."""


@dataclass(frozen=True)
class Seen:
    """Slopes of the score between proposals and their chains' own tapes, of M chains or R runs.

    Attributes:
        pairs: (M,) looked at.
        steep: (M,) of them, those that are steeper than the bound.
        most: (M,) the steepest, score per unit of length of the tape.
    """

    pairs: Integers
    steep: Integers
    most: Floats

    @staticmethod
    def none(many: int) -> Seen:
        """Nothing yet."""
        zeros = np.zeros(many, dtype=np.int64)
        return Seen(zeros, zeros, np.zeros(many))


@dataclass(frozen=True)
class Arcs:
    """What has been ruled out, of M chains after J turns.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        bound: (M,) on the slope, score per radian.
        tried: (M, J) angles.
        short: (M, J) how far below the level their scores are; 0 rules out nothing.
        seen: What has been noticed of the slope.
    """

    other: Floats
    bound: Floats
    tried: Floats
    short: Floats
    seen: Seen


@dataclass(frozen=True)
class Slope:
    """What is learnt: (R,) ``bound``, score per radian."""

    bound: Floats


class _Elimination:
    """What both kernels share."""

    rollouts = 4.0

    def tell(self, move: Move, found: Points) -> Move:
        """Who has come into the set is done; for the others a part of the ellipse falls away."""
        rows, work = move.waiting, move.work
        good = found.above(move.level[rows])
        short = np.zeros((len(move.level), 1))
        known = ~good & np.isfinite(found.score) & np.isfinite(move.level[rows])
        short[rows[known], 0] = (move.level[rows] - found.score)[known]
        work = replace(work, short=np.concatenate([work.short, short], axis=1))
        move, rows = move.take(good, found), rows[~good]
        if move.turn >= _MOST_TURNS or not len(rows):
            return replace(move.stay(), work=work)
        uniforms = move.draw.uniforms(rows, move.turn)
        angle, empty = free_angle(work.tried[rows], work.short[rows] / work.bound[rows, None], uniforms)
        if empty.any():
            work, angle = self._emptied(work, rows, empty, angle, uniforms)
        tried = np.zeros((len(move.level), 1))
        tried[rows, 0] = angle
        work = replace(work, tried=np.concatenate([work.tried, tried], axis=1))
        proposal = rotated(move.state.tape[rows], work.other[rows], angle)
        return replace(move, proposal=proposal, turn=move.turn + 1, work=work)

    def _emptied(
        self, work: Arcs, rows: Integers, empty: Bools, angle: Floats, uniforms: Floats
    ) -> tuple[Arcs, Floats]:
        """No angle is left for the ``empty`` of ``rows``: the bound was none; it grows until one is left."""
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
        arcs = Arcs(other, bound, angle[:, None], np.zeros((len(level), 0)), Seen.none(len(level)))
        return Move.begin(state, level, draw, rotated(state.tape, other, angle), arcs)


class LipschitzKernel(_Elimination, Untaught):
    """Valid where ``slope`` bounds the score's slope per unit of Euclidean length of the tape.

    On an ellipse with axes a and b the tape moves by at most the largest singular value of (a, b) per radian.
    No sample proves a bound, but one that a pair of tapes exceeds is none: ``known`` are the slopes seen.
    """

    def __init__(self, slope: float) -> None:
        self.slope = slope

    def init(self, runs: int) -> Seen:
        """Nothing has been seen."""
        return Seen.none(runs)

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        """A fresh ellipse, its own bound, and a first angle."""
        other = draw.tapes()
        return self._first(state, level, draw, other, self.slope * _stretch(state.tape, other))

    def tell(self, move: Move, found: Points) -> Move:
        """Note the slopes, then go on."""
        rows, own, old = move.waiting, move.state, move.work.seen
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
        return super().tell(replace(move, work=replace(move.work, seen=Seen(pairs, steep, most))), found)

    def watch(self, known: Seen, info: Info) -> Seen:
        """Add what the chains of each run have seen in a step."""
        pairs, steep, most = known.pairs.copy(), known.steep.copy(), known.most.copy()
        np.add.at(pairs, info.run, info.work.seen.pairs)
        np.add.at(steep, info.run, info.work.seen.steep)
        np.maximum.at(most, info.run, info.work.seen.most)
        return Seen(pairs, steep, most)

    def warnings(self, known: Seen) -> dict[str, str]:
        """Whether the bound is none."""
        steep, pairs = int(known.steep.sum()), int(known.pairs.sum())
        if not steep:
            return {}
        return health.warn(
            "lipschitz_exceeded", steep=steep, pairs=pairs, slope=self.slope, most=known.most.max()
        )


class GrowingLipschitzKernel(_Elimination):
    """The paper's: one slope per radian for all ellipses of a run, a guess that grows. Biased."""

    note = (
        "kernel lipschitz_growing is a heuristic: its guess of the slope may rule out what belongs to the "
        "level, and the estimate is biased, mostly upwards"
    )

    def __init__(self, guess: float) -> None:
        self.guess = guess

    def init(self, runs: int) -> Slope:
        """The first guess."""
        return Slope(np.full(runs, self.guess))

    def learn(self, known: Slope, runs: Integers, points: Points, level: Floats) -> Slope:
        """The guess of the last level."""
        return known

    def start(self, known: Slope, state: Points, level: Floats, draw: Draw) -> Move:
        """A fresh ellipse and a first angle."""
        return self._first(state, level, draw, draw.tapes(), known.bound)

    def adapt(self, known: Slope, info: Info) -> Slope:
        """The largest guess that a chain of the run has come to."""
        bound = known.bound.copy()
        np.maximum.at(bound, info.run, info.work.bound)
        return Slope(bound)


def free_angle(center: Floats, half: Floats, uniforms: Floats) -> tuple[Floats, Bools]:
    """An angle uniform on what arcs leave of the circle.

    Args:
        center: (W, J) of the arcs, in [0, 2 pi).
        half: (W, J) half their widths; 0 for none.
        uniforms: (W,) in (0, 1).

    Returns:
        (W,) angles, and (W,) where nothing is left (the angle means nothing there).
    """
    half = np.minimum(half, np.pi)
    low = np.mod(center - half, _CIRCLE)
    high = low + 2.0 * half
    over = np.maximum(high - _CIRCLE, 0.0)  # what lies beyond 2 pi begins at 0 again
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


def _stretch(a: Floats, b: Floats) -> Floats:
    """(M,) largest singular value of the tapes (a, b)."""
    aa, bb, ab = (_dot(x, y) for x, y in ((a, a), (b, b), (a, b)))
    return np.asarray(np.sqrt(0.5 * (aa + bb + np.hypot(aa - bb, 2.0 * ab))))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).reshape(len(a), -1).sum(axis=1))
