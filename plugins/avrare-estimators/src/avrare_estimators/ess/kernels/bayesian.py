"""Bayesian optimisation of the score along an ellipse: Algorithm 1 of stl-ess unchanged, a heuristic.

A Gaussian process in the angle learns the score from a few rollouts, chosen by an upper confidence bound;
then an angle is drawn where its mean lies above the level. Nothing checks that the tape found does, and the
process depends on the chain's own point: the step is not reversible, and the estimate is biased. The kernel
``surrogate`` is a valid alternative.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_estimators.ess.chains import Draw, Kernel, Move, Points, rotated

_CIRCLE = 2.0 * np.pi
_POINTS = 6
"""Rollouts of a round of optimisation, N_BO."""
_MOST_ROUNDS = 3
_KAPPA, _KAPPA_LATER = 2.576, 1.0
_LENGTH = 1.0
"""Length scale of the process, radians."""
_JITTER = 1e-4
_GRID = (np.arange(96) + 0.5) * (_CIRCLE / 96)


@dataclass(frozen=True)
class _Search:
    """_Search along the ellipses of M chains, after J turns.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        angle: (M, J + 2) angles tried, after the chain's own at 0 and 2 pi.
        score: (M, J + 2) their scores.
        last: (M,) the present proposal is the chain's next point, not one to learn from.
    """

    other: Floats
    angle: Floats
    score: Floats
    last: Bools


class BayesianKernel(Kernel):
    """The paper's surrogate sampler, one Gaussian process for each step of each chain."""

    note = (
        "kernel bayesian is a heuristic: where its surrogate is wrong chains leave the level, and the "
        "estimate is biased"
    )
    rollouts = _POINTS + 1.0

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        # The chain's own score is known at 0 and 2 pi (lines 1-6).
        own = np.repeat(np.where(np.isfinite(state.score), state.score, 0.0)[:, None], 2, axis=1)
        angle = np.tile([0.0, _CIRCLE], (len(level), 1))
        search = _Search(draw.tapes(), angle, own, np.zeros(len(level), dtype=bool))
        move = Move.begin(state, level, draw, state.tape, search)
        return self._propose(move, *_most_promising_angle(search.angle, search.score, _KAPPA))

    def tell(self, move: Move, found: Points) -> Move:
        # Learn from the proposals, or go there; a round ends with a draw where the mean is high.
        work, rows = move.work, move.waiting
        score = np.where(np.isfinite(found.score), found.score, work.score[rows].min(axis=1))
        column = np.zeros((len(move.level), 1))
        column[rows, 0] = score
        work = replace(work, score=np.concatenate([work.score, column], axis=1))
        going = work.last[rows] & (found.violated | np.isfinite(found.score))
        ended = work.last[rows]
        rows = rows[~ended]
        move = replace(move.accept(going, found), work=work, waiting=rows)
        return self._next(move) if len(rows) else move.stay()

    def _next(self, move: Move) -> Move:
        work, rows, rounds = move.work, move.waiting, move.turn // _POINTS
        angle, score = work.angle[rows], work.score[rows]
        suggested, _ = _most_promising_angle(angle, score, _KAPPA if rounds == 0 else _KAPPA_LATER)
        last: Bools = np.zeros(len(rows), dtype=bool)
        if move.turn % _POINTS == 0:
            mean, _ = _posterior(angle, score)
            active = mean >= move.level[rows, None]
            last = np.asarray(active.any(axis=1) | (rounds >= _MOST_ROUNDS))
            uniforms = move.draw.uniforms(rows, move.turn)
            suggested = np.where(active.any(axis=1), _uniform_on_cells(active, uniforms), suggested)
            suggested = np.where(last & ~active.any(axis=1), 0.0, suggested)  # no such angle: stay
        return self._propose(move, suggested, last)

    def _propose(self, move: Move, angle: Floats, last: Bools) -> Move:
        rows, work = move.waiting, move.work
        column = np.zeros((len(move.level), 1))
        column[rows, 0] = angle
        flags = work.last.copy()
        flags[rows] = last
        work = replace(work, angle=np.concatenate([work.angle, column], axis=1), last=flags)
        proposal = rotated(move.state.tape[rows], work.other[rows], angle)
        turn = work.angle.shape[1] - 2
        return replace(move, proposal=proposal, turn=turn, work=work)


def _most_promising_angle(angle: Floats, score: Floats, kappa: float) -> tuple[Floats, Bools]:
    # The largest upper confidence bound (line 10); none is the last.
    mean, spread = _posterior(angle, score)
    return _GRID[np.argmax(mean + kappa * spread, axis=1)], np.zeros(len(angle), dtype=bool)


def _uniform_on_cells(active: Bools, uniforms: Floats) -> Floats:
    # Line 17; ``active`` is (W, G).
    count = np.cumsum(active, axis=1)
    place = uniforms * count[:, -1]
    cell = np.minimum((count <= place[:, None]).sum(axis=1), len(_GRID) - 1)
    return np.asarray(_GRID[cell] + (place - np.floor(place) - 0.5) * (_CIRCLE / len(_GRID)))


def _posterior(angle: Floats, score: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (W, G) on the grid, given scores (W, J) at angles (line 14)."""
    middle = score.mean(axis=1, keepdims=True)
    scale = np.maximum(score.std(axis=1, keepdims=True), 1e-9)
    among = _matern_52(angle[:, :, None] - angle[:, None, :]) + _JITTER * np.eye(angle.shape[1])
    across = _matern_52(angle[:, :, None] - _GRID)
    weights = np.linalg.solve(among, across)
    mean = (weights * ((score - middle) / scale)[:, :, None]).sum(axis=1)
    variance = 1.0 - (weights * across).sum(axis=1)
    return middle + scale * mean, scale * np.sqrt(np.maximum(variance, 0.0))


def _matern_52(distance: Floats) -> Floats:
    r = np.sqrt(5.0) * np.abs(distance) / _LENGTH
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))
