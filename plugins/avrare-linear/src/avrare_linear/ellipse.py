"""Elliptical slices: the failing part of an ellipse of tapes, in closed form (stl-ess, Theorem IV.1).

1. On z cos(theta) + nu sin(theta) every affine margin is a sinusoid about its mean. Its crossings of the
   level cut the ellipse into segments on which no predicate changes its truth.
2. One evaluation of the formula at the middle of each segment decides whether the segment fails.
3. A conjunction fails where one of its parts does: ``always`` over predicates of a single sample is cut
   sample by sample, with few crossings each, and the failing segments are united.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.logic.formula import Formula
from avrare.protocols import Bools, Floats, System
from avrare_linear.gaussian import TrajectoryGaussian
from avrare_linear.predicates import AffineFormula, Conjunct

_TURN = 2.0 * np.pi
_BLOCK = 2_000_000
"""Most numbers per array of margins."""


@dataclass(frozen=True)
class Segments:
    """Disjoint ascending parts of [0, 2 pi), for M ellipses.

    Attributes:
        low: (M, W) starts, radians.
        high: (M, W) ends; equal to ``low`` for entries that only fill the row.
    """

    low: Floats
    high: Floats

    @property
    def length(self) -> Floats:
        """(M,) total length, radians."""
        return np.cumsum(self.high - self.low, axis=1)[:, -1]

    def contains(self, theta: Floats) -> Bools:
        """Check which angles (M, K) lie in a segment: (M, K)."""
        at = theta[:, None, :]
        return np.asarray(((self.low[..., None] <= at) & (at < self.high[..., None])).any(axis=1))


def draw_angles(segments: Segments, uniforms: Floats) -> Floats:
    """Draw angles (M,) uniform on the segments from uniforms (M,); 0 for rows without segments."""
    reached = np.cumsum(segments.high - segments.low, axis=1)
    target = uniforms * reached[:, -1]
    place = np.minimum((reached <= target[:, None]).sum(axis=1), reached.shape[1] - 1)
    row = np.arange(len(place))
    angle = segments.high[row, place] - (reached[row, place] - target)
    return np.where(reached[:, -1] > 0.0, angle, 0.0)


class Slicer:
    """Slices of a formula's failure set along ellipses.

    Args:
        gaussian: Distribution of the signals that the formula reads.
        formula: Formula with affine predicates.

    Raises:
        UsageError: A term is not affine, or a signal is missing.
    """

    def __init__(self, gaussian: TrajectoryGaussian, formula: Formula | AffineFormula) -> None:
        self.formula = affine = formula if isinstance(formula, AffineFormula) else AffineFormula.of(formula)
        self.gaussian = gaussian.select(affine.signals)
        self.mean = affine.combine(affine.signals, self.gaussian.mean)
        self.conjuncts = affine.conjuncts(gaussian.steps)

    @staticmethod
    def of(system: System, steps: int, formula: Formula | AffineFormula) -> Slicer:
        """Make the slicer of a system that is affine in its noise.

        Raises:
            UsageError: The system or a term of the formula is not affine, or the formula reads no signal.
        """
        affine = formula if isinstance(formula, AffineFormula) else AffineFormula.of(formula)
        if not affine.signals:
            raise UsageError(f"the formula reads no signal: {formula}")
        return Slicer(TrajectoryGaussian.of(system, steps, affine.signals), affine)

    def margins(self, tape: Floats) -> Floats:
        """Return the predicates' margins (M, T + 1, P), less their mean, of tapes (M, T + 1, noise_size)."""
        return self.formula.combine(self.gaussian.names, self.gaussian.deviations(tape), constant=False)

    def segments(self, tape: Floats, other: Floats, level: Floats | float = 0.0) -> Segments:
        """Return where the robustness is below a level on tape cos(theta) + other sin(theta).

        Args:
            tape: (M, T + 1, noise_size).
            other: (M, T + 1, noise_size).
            level: Robustness: a number, (M,), (M, T + 1) for a level per sample, or (M, T + 1, P) for one per
                sample and predicate.
        """
        return self.cut(self.margins(tape), self.margins(other), level)

    def cut(self, along: Floats, across: Floats, level: Floats | float = 0.0) -> Segments:
        """Return the segments from the margins (M, T + 1, P) of both tapes."""
        rows = len(along)
        shift = np.asarray(level, dtype=np.float64)
        if shift.ndim == 0:
            shift = shift[None]
        shift = np.broadcast_to(
            shift.reshape(shift.shape + (1,) * (3 - shift.ndim)), (rows, *self.mean.shape)
        )
        arcs = [self._arcs(part, shift, along, across) for part in self.conjuncts]
        filler = np.full((rows, 1), _TURN)  # an empty segment, in case that nothing can be violated
        low = np.concatenate([filler, *(low for low, _ in arcs)], axis=1)
        high = np.concatenate([filler, *(high for _, high in arcs)], axis=1)
        return _union(low, high)

    def _arcs(self, part: Conjunct, shift: Floats, along: Floats, across: Floats) -> tuple[Floats, Floats]:
        # Low and high (M, Q S) of the arcs where the part is violated, both 2 pi where it is not.
        windows, used = part.windows[:, :, None], np.array(part.used, dtype=np.int64)
        queries, crossings = len(windows), 2 * windows.shape[1] * len(used)
        block = max(1, _BLOCK // max(1, queries * (crossings + 1) * crossings))
        arcs = []
        for first in range(0, len(shift), block):
            rows = slice(first, first + block)
            offset = self.mean[windows, used] - shift[rows, windows, used]
            arcs.append(_cut(part, offset, along[rows, windows, used], across[rows, windows, used]))
        width = max(low.shape[1] for low, _ in arcs)
        pads = [((0, 0), (0, width - low.shape[1])) for low, _ in arcs]
        low, high = (
            np.concatenate(
                [np.pad(pair[k], pad, constant_values=_TURN) for pair, pad in zip(arcs, pads, strict=True)]
            )
            for k in (0, 1)
        )
        return low, high


def _cut(part: Conjunct, offset: Floats, along: Floats, across: Floats) -> tuple[Floats, Floats]:
    # Failing arcs (M, Q S) of offset + along cos + across sin, (M, Q, W, J) each.
    rows, queries, width, many = offset.shape
    flat = (rows, queries, width * many)
    # 1. Cut at the crossings.
    edges = _edges(*(x.reshape(flat) for x in (offset, along, across)))
    # 2. Evaluate the formula in the middle of each segment.
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])  # (M, Q, S)
    cosine, sine = np.cos(middle), np.sin(middle)
    margins = np.empty((many, width, *middle.shape))
    for w in range(width):
        for j in range(many):
            a, b, d = (x[:, :, w, j, None] for x in (offset, along, across))
            margins[j, w] = a + b * cosine + d * sine
    bad = part.find_violations(margins.reshape(many, width, -1)).reshape(middle.shape)
    # 3. Keep the failing segments.
    low, high = np.where(bad, edges[..., :-1], _TURN), np.where(bad, edges[..., 1:], _TURN)
    return low.reshape(rows, -1), high.reshape(rows, -1)


def _edges(offset: Floats, along: Floats, across: Floats) -> Floats:
    # Ends of the segments (M, Q, S + 1), ascending from 0 to 2 pi, padded with 2 pi.
    size, phase = np.hypot(along, across), np.arctan2(across, along)
    crosses = size > np.abs(offset)
    half = np.arccos(np.where(crosses, -offset / np.where(crosses, size, 1.0), 0.0))
    roots = [np.where(crosses, np.mod(phase + side * half, _TURN), _TURN) for side in (1.0, -1.0)]
    most = 2 * int(crosses.sum(axis=2).max(initial=0))
    inner = np.sort(np.concatenate(roots, axis=2), axis=2)[..., :most]
    ends = np.zeros((*offset.shape[:2], 1))
    return np.concatenate([ends, inner, ends + _TURN], axis=2)


def _union(low: Floats, high: Floats) -> Segments:
    filled = low < high
    order = np.argsort(np.where(filled, low, _TURN), axis=1, kind="stable")
    order = order[:, : max(1, int(filled.sum(axis=1).max(initial=0)))]
    low, high = np.take_along_axis(low, order, axis=1), np.take_along_axis(high, order, axis=1)
    reach = np.maximum.accumulate(high, axis=1)
    begin = low.copy()
    begin[:, 1:] = np.maximum(low[:, 1:], reach[:, :-1])
    return Segments(np.minimum(begin, reach), reach)
