"""Elliptical slice sampling with a shrinking bracket (Murray, Adams and MacKay 2010): nothing to tune.

The chain's tape and a fresh one span an ellipse of tapes. A first angle is uniform; each proposal outside the
level's set shrinks the bracket towards the chain's own tape, from which a further angle is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.protocols import Floats
from avrare_estimators.chains import Draw, Move, Points, Untaught, rotated

_MOST_TURNS = 100
"""By then a bracket is 2^-100 of the ellipse: the proposal is the chain's own tape."""


@dataclass(frozen=True)
class Bracket:
    """Of M chains.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        angle: (M,) of the proposal in hand.
        low: (M,) end of the bracket.
        high: (M,) end of the bracket.
    """

    other: Floats
    angle: Floats
    low: Floats
    high: Floats


class ShrinkKernel(Untaught):
    """Valid for any system and score.

    Args:
        width: Of the first bracket, radians: the whole ellipse, or a part of it laid about the chain's own
            tape at random (Neal 2003), which spares rollouts where the set is narrow.
    """

    rollouts = 4.0

    def __init__(self, width: float = 2.0 * np.pi) -> None:
        self.width = width

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        """A fresh ellipse and its first angle."""
        other, rows = draw.tapes(), np.arange(len(level))
        angle = self.width * draw.uniforms(rows, 0)
        high = angle.copy()
        if self.width < 2.0 * np.pi:
            high = self.width * draw.uniforms(rows, _MOST_TURNS)  # no bracket shrinks so often
            angle += high - self.width
        bracket = Bracket(other, angle, high - self.width, high)
        return Move.begin(state, level, draw, rotated(state.tape, other, angle), bracket)

    def tell(self, move: Move, found: Points) -> Move:
        """Who has come into the set is done; the others shrink their brackets."""
        rows = move.waiting
        good = found.above(move.level[rows])
        move, rows = move.take(good, found), rows[~good]
        if move.turn >= _MOST_TURNS:
            return move.stay()
        old: Bracket = move.work
        low, high, angle = old.low.copy(), old.high.copy(), old.angle.copy()
        below = angle[rows] < 0.0
        low[rows[below]], high[rows[~below]] = angle[rows[below]], angle[rows[~below]]
        angle[rows] = low[rows] + (high[rows] - low[rows]) * move.draw.uniforms(rows, move.turn)
        proposal = rotated(move.state.tape[rows], old.other[rows], angle[rows])
        return replace(move, proposal=proposal, turn=move.turn + 1, work=Bracket(old.other, angle, low, high))
