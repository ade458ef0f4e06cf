"""Delayed acceptance: slices of a surrogate of the level's set, and one true rollout a step.

A response surface of the score is fitted in the pilot, on the samples that a level starts from, and frozen.
A step is elliptical slice sampling under the soft likelihood l(x) of that surface, which costs no rollout;
its end is rolled out and accepted with probability min(1, l(x) / l(x')), if it lies in the set. The ratio
corrects for the surrogate's preference (Christen and Fox 2005): the step is valid however wrong the surface
is.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, rotated

_FLOOR = 0.02
"""Least likelihood: no tape is excluded."""
_MOST_ROWS = 300
_RIDGES = 10.0 ** np.arange(-3.0, 3.5, 0.5)
_MOST_TURNS = 60


@dataclass(frozen=True)
class Surface:
    """Response surface of each run: score = constant + linear . x + square . x^2.

    Attributes:
        constant: (R,).
        linear: (R, D) coefficients of the tape's numbers.
        square: (R, D) coefficients of their squares.
        level: (R,) level of the set.
        width: (R,) standard error of the surface, positive.
    """

    constant: Floats
    linear: Floats
    square: Floats
    level: Floats
    width: Floats

    def likelihood(self, tape: Floats) -> Floats:
        """Return the soft likelihood (M,) in (0, 1] of tapes, one for each row of the surface."""
        x = tape.reshape(len(tape), -1)
        score = self.constant + (self.linear * x + self.square * x**2).sum(axis=1)
        odds = np.clip(1.7 * (score - self.level) / self.width, -500.0, 500.0)
        return np.asarray(_FLOOR + (1.0 - _FLOOR) / (1.0 + np.exp(-odds)))


class SurrogateKernel(Kernel):
    """Valid: the surface is frozen, and the acceptance corrects for it."""

    name = "surrogate"

    def init(self, runs: int) -> Surface | None:
        return None  # the surface of a level is fitted when it begins

    def learn(self, tuning: Surface | None, runs: Integers, points: Points, level: Floats) -> Surface:
        x = points.tape.reshape(len(level), -1, points.tape[0].size)
        score = points.score.reshape(len(level), -1)
        fits = [_fit_surface(x[a], score[a], level[a]) for a in range(len(level))]
        new = batch.concatenate(fits)
        total = max(int(runs[-1]) + 1, 0 if tuning is None else len(tuning.level))
        place = np.zeros(total, dtype=np.int64)
        place[runs] = np.arange(len(runs))
        return batch.take(new, place)  # ended runs get any surface, and never use it

    def start(self, tuning: Surface, state: Points, level: Floats, draw: Draw) -> Move:
        proposal = _slice_under_surrogate(tuning, state.tape, draw)
        # The acceptance ratio (M,) l(x) / l(x') of the step's ends.
        ratio = tuning.likelihood(state.tape) / tuning.likelihood(proposal)
        return Move.begin(state, level, draw, proposal, ratio)

    def tell(self, move: Move, points: Points) -> Move:
        rows = move.waiting
        chance = move.work[rows] > move.draw.uniforms(rows, _MOST_TURNS + 2)
        return move.accept(chance & points.above(move.level[rows]), points).stay()


def _slice_under_surrogate(surface: Surface, tape: Floats, draw: Draw) -> Floats:
    # See ``shrink``, whose bracket this is.
    rows = np.arange(len(tape))
    other, end = draw.tapes(), tape.copy()
    height = surface.likelihood(tape) * draw.uniforms(rows, 0)
    angle = 2.0 * np.pi * draw.uniforms(rows, 1)
    low, high = angle - 2.0 * np.pi, angle.copy()
    for turn in range(2, _MOST_TURNS + 2):
        moved = rotated(tape[rows], other[rows], angle[rows])
        inside = batch.take(surface, rows).likelihood(moved) > height[rows]
        end[rows[inside]] = moved[inside]
        rows = rows[~inside]
        if not len(rows):
            break
        low[rows] = np.where(angle[rows] < 0.0, angle[rows], low[rows])
        high[rows] = np.where(angle[rows] < 0.0, high[rows], angle[rows])
        angle[rows] = low[rows] + (high[rows] - low[rows]) * draw.uniforms(rows, turn)
    return end


def _fit_surface(x: Floats, score: Floats, level: float) -> Surface:
    """Fit one run's scores (N,) to its tapes (N, D) and their squares by ridge regression; a batch of one."""
    rows = np.flatnonzero(np.isfinite(score))
    rows = rows[:: max(1, -(-len(rows) // _MOST_ROWS))]
    x, score = x[rows], score[rows]
    features = np.concatenate([x, x**2], axis=1)
    shift, scale = features.mean(axis=0), features.std(axis=0)
    scale[scale == 0.0] = 1.0
    features = (features - shift) / scale
    values, vectors = np.linalg.eigh(features @ features.T)
    target = vectors.T @ (score - score.mean())
    weights, width = _select_ridge(np.maximum(values, 0.0), vectors, target, score)
    slopes = features.T @ weights / scale
    d = x.shape[1]
    constant = score.mean() - slopes @ shift
    return Surface(
        np.array([constant]), slopes[None, :d], slopes[None, d:], np.array([float(level)]), np.array([width])
    )


def _select_ridge(values: Floats, vectors: Floats, target: Floats, score: Floats) -> tuple[Floats, float]:
    best: tuple[Any, float] = (np.zeros(len(score)), float(score.std()))
    for ridge in _RIDGES * len(score):
        inverse = 1.0 / (values + ridge)
        weights = vectors @ (inverse * target)
        left_out = weights / (vectors**2 @ inverse)
        error = float(np.sqrt(np.mean(left_out**2)))
        if error < best[1]:
            best = (weights, error)
    return best[0], max(best[1], 1e-9)
