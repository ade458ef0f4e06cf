"""Preconditioned Crank-Nicolson steps of an adapted size: one rollout a step (Papaioannou et al. 2015).

A proposal is the chain's tape turned towards a fresh one by a fixed angle; it is taken if it lies in the
level's set. The angle follows the rate of acceptance, run by run, in the pilot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.chains import Draw, Info, Move, Points, rotated

_ACCEPTANCE = 0.44
_FIRST, _LEAST = 0.7, 0.02
_GAIN = 0.7
"""Of the adaptation; the noise of a few chains must not swamp what is known."""


@dataclass(frozen=True)
class Size:
    """What is learnt: (R,) ``angle`` of a step, in radians."""

    angle: Floats


class PcnKernel:
    """Valid once the size is frozen."""

    note = ""
    rollouts = 1.0

    def init(self, runs: int) -> Size:
        """A first size."""
        return Size(np.full(runs, _FIRST))

    def learn(self, known: Size, runs: Integers, points: Points, level: Floats) -> Size:
        """The size of the last level will nearly do."""
        return known

    def start(self, known: Size, state: Points, level: Floats, draw: Draw) -> Move:
        """One proposal a chain."""
        return Move.begin(state, level, draw, rotated(state.tape, draw.tapes(), known.angle), ())

    def tell(self, move: Move, found: Points) -> Move:
        """Take it, or stay."""
        return move.take(found.above(move.level[move.waiting]), found).stay()

    def adapt(self, known: Size, info: Info) -> Size:
        """Longer steps where many are accepted."""
        many = np.bincount(info.run, minlength=len(known.angle))
        rate = np.bincount(info.run, info.accepted, minlength=len(known.angle)) / np.maximum(many, 1)
        factor = np.exp(_GAIN * (rate - _ACCEPTANCE))
        angle = np.clip(known.angle * np.where(many > 0, factor, 1.0), _LEAST, np.pi / 2.0)
        return Size(angle)
