"""Elliptical slice sampling with a shrinking bracket (Murray, Adams and MacKay 2010): nothing to tune.

The chain's tape and a fresh one span an ellipse of tapes. The first angle is uniform; each proposal outside
the level's set shrinks the bracket towards the chain's own tape, from which a further angle is drawn.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Floats
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, rotate

_MOST_TURNS = 100
"""By then a bracket is 2^-100 of the ellipse: the proposal is the chain's own tape."""


@dataclass(frozen=True)
class _Bracket:
    """Brackets of M chains.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        angle: (M,) angle of the present proposal.
        low: (M,) lower end of the bracket.
        high: (M,) upper end of the bracket.
    """

    other: Floats
    angle: Floats
    low: Floats
    high: Floats


class ShrinkKernel(Kernel):
    """Valid for any system and score.

    Args:
        width: Width of the first bracket, radians: the complete ellipse, or a part of it placed at random
            around the chain's own tape (Neal 2003), which saves rollouts where the set is narrow.
    """

    name = "shrink"
    rollouts = 4.0

    def __init__(self, width: float = 2.0 * np.pi) -> None:
        self.width = width

    def start(self, tuning: object, state: Points, level: Floats, draw: Draw) -> Move:
        # 1. The second axis of the ellipse.
        other, rows = draw.tapes(), np.arange(len(level))
        # 2. A bracket of the given width that holds angle 0, and an angle uniform on it.
        angle = self.width * draw.uniforms(rows, 0)
        high = angle.copy()
        if self.width < 2.0 * np.pi:
            high = self.width * draw.uniforms(rows, _MOST_TURNS)  # no bracket shrinks so often
            angle += high - self.width
        bracket = _Bracket(other, angle, high - self.width, high)
        return Move.begin(state, level, draw, rotate(state.tape, other, angle), bracket)

    def tell(self, move: Move, points: Points) -> Move:
        # 3. Accept a proposal inside the level's set.
        rows = move.waiting
        good = points.above(move.level[rows])
        move, rows = move.accept(good, points), rows[~good]
        if move.turn >= _MOST_TURNS:
            return move.stay()
        # 4. Otherwise the rejected angle becomes the end of the bracket on its side of 0.
        old: _Bracket = move.work
        low, high, angle = old.low.copy(), old.high.copy(), old.angle.copy()
        below = angle[rows] < 0.0
        low[rows[below]], high[rows[~below]] = angle[rows[below]], angle[rows[~below]]
        # 5. Draw the next angle uniformly on what is left; go on with step 3.
        angle[rows] = low[rows] + (high[rows] - low[rows]) * move.draw.uniforms(rows, move.turn)
        proposal = rotate(move.state.tape[rows], old.other[rows], angle[rows])
        return replace(
            move, proposal=proposal, turn=move.turn + 1, work=_Bracket(old.other, angle, low, high)
        )
