"""Delayed acceptance: slices of a surrogate of the level's set, and one true rollout a step.

A response surface of the score is fitted in the pilot, on the samples that a level starts from, and frozen.
A step is elliptical slice sampling under the soft likelihood l(x) of that surface, which costs no rollout;
where it ends is rolled out and taken with probability min(1, l(x) / l(x')), if it lies in the set. The
ratio undoes what the surrogate prefers (Christen and Fox 2005): the step is valid however wrong the surface
is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare import batch
from avrare.protocols import Floats
from avrare.rollout.request import Integers
from avrare_estimators.chains import Draw, Info, Move, Points, rotated

_FLOOR = 0.02
"""Least likelihood: nothing is out of the question."""
_MOST_ROWS = 300
_RIDGES = 10.0 ** np.arange(-3.0, 3.5, 0.5)
_MOST_TURNS = 60


@dataclass(frozen=True)
class Surface:
    """What is learnt: score = constant + linear . x + square . x^2, of each run.

    Attributes:
        constant: (R,).
        linear: (R, D) for the tape's numbers.
        square: (R, D) for their squares.
        level: (R,) of the set.
        width: (R,) standard error of the surface, positive.
    """

    constant: Floats
    linear: Floats
    square: Floats
    level: Floats
    width: Floats

    def likelihood(self, tape: Floats) -> Floats:
        """(M,) of tapes (M, steps + 1, noise_size) of which each has its row here; in (0, 1]."""
        x = tape.reshape(len(tape), -1)
        score = self.constant + (self.linear * x + self.square * x**2).sum(axis=1)
        odds = np.clip(1.7 * (score - self.level) / self.width, -500.0, 500.0)
        return np.asarray(_FLOOR + (1.0 - _FLOOR) / (1.0 + np.exp(-odds)))


@dataclass(frozen=True)
class Odds:
    """(M,) ``ratio`` l(x) / l(x') of a step's ends."""

    ratio: Floats


class SurrogateKernel:
    """Valid: the surface is frozen, and the acceptance undoes it."""

    note = ""
    rollouts = 1.0

    def init(self, runs: int) -> Surface | None:
        """Nothing: the surface of a level is fitted when it begins."""
        return None

    def learn(self, known: Surface | None, runs: Integers, points: Points, level: Floats) -> Surface:
        """A new surface for each of ``runs``, fitted on their samples."""
        x = points.tape.reshape(len(level), -1, points.tape[0].size)
        score = points.score.reshape(len(level), -1)
        fits = [_fit(x[a], score[a], level[a]) for a in range(len(level))]
        new = batch.concatenate(fits)
        total = max(int(runs[-1]) + 1, 0 if known is None else len(known.level))
        place = np.zeros(total, dtype=np.int64)
        place[runs] = np.arange(len(runs))
        return batch.take(new, place)  # runs that have ended get somebody's, and never ask for it

    def start(self, known: Surface, state: Points, level: Floats, draw: Draw) -> Move:
        """The surrogate's step, whose end wants a rollout."""
        proposal = _slice(known, state.tape, draw)
        ratio = known.likelihood(state.tape) / known.likelihood(proposal)
        return Move.begin(state, level, draw, proposal, Odds(ratio))

    def tell(self, move: Move, found: Points) -> Move:
        """Take it with the probability that undoes the surrogate."""
        rows = move.waiting
        chance = move.work.ratio[rows] > move.draw.uniforms(rows, _MOST_TURNS + 2)
        return move.take(chance & found.above(move.level[rows]), found).stay()

    def adapt(self, known: Surface, info: Info) -> Surface:
        """The surface is frozen."""
        return known


def _slice(known: Surface, tape: Floats, draw: Draw) -> Floats:
    """Where slice sampling under the surrogate comes to from ``tape`` (M, steps + 1, noise_size)."""
    rows = np.arange(len(tape))
    other, end = draw.tapes(), tape.copy()
    height = known.likelihood(tape) * draw.uniforms(rows, 0)
    angle = 2.0 * np.pi * draw.uniforms(rows, 1)
    low, high = angle - 2.0 * np.pi, angle.copy()
    for turn in range(2, _MOST_TURNS + 2):
        moved = rotated(tape[rows], other[rows], angle[rows])
        inside = batch.take(known, rows).likelihood(moved) > height[rows]
        end[rows[inside]] = moved[inside]
        rows = rows[~inside]
        if not len(rows):
            break
        low[rows] = np.where(angle[rows] < 0.0, angle[rows], low[rows])
        high[rows] = np.where(angle[rows] < 0.0, high[rows], angle[rows])
        angle[rows] = low[rows] + (high[rows] - low[rows]) * draw.uniforms(rows, turn)
    return end


def _fit(x: Floats, score: Floats, level: float) -> Surface:
    """Ridge regression of one run's scores (N,) on the tapes (N, D) and their squares, as a batch of one."""
    keep = np.flatnonzero(np.isfinite(score))
    keep = keep[:: max(1, -(-len(keep) // _MOST_ROWS))]
    x, score = x[keep], score[keep]
    features = np.concatenate([x, x**2], axis=1)
    shift, scale = features.mean(axis=0), features.std(axis=0)
    scale[scale == 0.0] = 1.0
    features = (features - shift) / scale
    values, vectors = np.linalg.eigh(features @ features.T)
    target = vectors.T @ (score - score.mean())
    weights, width = _best_ridge(np.maximum(values, 0.0), vectors, target, score)
    slopes = features.T @ weights / scale
    d = x.shape[1]
    constant = score.mean() - slopes @ shift
    return Surface(
        np.array([constant]), slopes[None, :d], slopes[None, d:], np.array([float(level)]), np.array([width])
    )


def _best_ridge(values: Floats, vectors: Floats, target: Floats, score: Floats) -> tuple[Floats, float]:
    """Dual weights (N,) and standard error of the ridge with the least leave-one-out error."""
    best: tuple[Any, float] = (np.zeros(len(score)), float(score.std()))
    for ridge in _RIDGES * len(score):
        inverse = 1.0 / (values + ridge)
        weights = vectors @ (inverse * target)
        left_out = weights / (vectors**2 @ inverse)
        error = float(np.sqrt(np.mean(left_out**2)))
        if error < best[1]:
            best = (weights, error)
    return best[0], max(best[1], 1e-9)
