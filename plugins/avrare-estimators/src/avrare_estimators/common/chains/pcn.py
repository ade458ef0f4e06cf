"""Preconditioned Crank-Nicolson steps of an adapted size: one rollout a step (Papaioannou et al. 2015).

A proposal is the chain's tape turned towards a fresh one by a fixed angle; it is accepted if it lies in the
level's set. The angle follows the rate of acceptance, run by run, in the pilot.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, StepOutcome, rotate

_ACCEPTANCE = 0.44
_FIRST, _LEAST = 0.7, 0.02
_GAIN = 0.7
"""Gain of the adaptation; low enough for the scatter of a few chains."""


class PcnKernel(Kernel):
    """Valid once the step size is frozen: the tuning is the angle (R,) in radians."""

    name = "pcn"

    def init(self, runs: int) -> Floats:
        return np.full(runs, _FIRST)

    def start(self, tuning: Floats, state: Points, level: Floats, draw: Draw) -> Move:
        return Move.begin(state, level, draw, rotate(state.tape, draw.tapes(), tuning), ())

    def tell(self, move: Move, points: Points) -> Move:
        return move.accept(points.above(move.level[move.waiting]), points).stay()

    def adapt(self, tuning: Floats, outcome: StepOutcome) -> Floats:
        # Lengthen the step of runs that accept often, shorten that of the others.
        chains = np.bincount(outcome.run, minlength=len(tuning))
        accepted = np.bincount(outcome.run, outcome.accepted, minlength=len(tuning))
        factor = np.exp(_GAIN * (accepted / np.maximum(chains, 1) - _ACCEPTANCE))
        return np.clip(tuning * np.where(chains > 0, factor, 1.0), _LEAST, np.pi / 2.0)
