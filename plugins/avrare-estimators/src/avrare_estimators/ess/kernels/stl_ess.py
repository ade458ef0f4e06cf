"""Kernels of stl-ess as the paper prints them, for comparison: heuristics that bias the estimate.

Algorithm 1, ``bayesian``: a Gaussian process in the angle learns the score along an ellipse from a few
rollouts, at angles that an acquisition function chooses; then an angle is drawn where its mean lies above the
level. Nothing checks that the tape drawn does, and the process depends on the chain's own point: the step is
not reversible. ``shrink`` is a valid alternative. Lines in the comments are those of Algorithm 1.

Algorithm 2, ``lipschitz_growing``: elimination with a guess of the slope that grows only once nothing is
left. ``lipschitz`` is a valid alternative.
"""

# ruff: noqa: D102 - ``Kernel`` documents the methods of all kernels.

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers
from avrare_estimators.common.chains.kernel import Draw, Kernel, Move, Points, StepOutcome, rotate
from avrare_estimators.ess.kernels.elimination import Elimination

AcquisitionName = Literal["ucb", "ei", "poi"]
_CIRCLE = 2.0 * np.pi
GRID = (np.arange(96) + 0.5) * (_CIRCLE / 96)
"""(G,) angles at which the process is looked at."""
_erfc = np.vectorize(math.erfc, otypes=[np.float64])


@dataclass(frozen=True)
class Acquisition:
    """Function of mean and spread of the process that is largest where the next rollout is worth most.

    Attributes:
        name: ``ucb``, upper confidence bound; ``ei``, expected improvement on the largest score so far;
            ``poi``, probability of an improvement.
        kappa: Standard deviations of the process above its mean, ``ucb``.
        xi: Improvement that does not count, ``ei`` and ``poi``, in standard deviations of the scores so far.
    """

    name: AcquisitionName = "ucb"
    kappa: float = 2.576
    xi: float = 0.0

    def exploiting(self) -> Acquisition:
        """Return the acquisition with the numbers of the paper for later rounds (line 20)."""
        return replace(self, kappa=1.0, xi=0.0)

    def __call__(self, mean: Floats, spread: Floats, best: Floats) -> Floats:
        """Return a value that ranks angles (M, G), given mean, spread (M, G) and the largest scores (M,)."""
        if self.name == "ucb":
            return mean + self.kappa * spread
        gain = mean - best[:, None] - self.xi
        spread = np.maximum(spread, 1e-12)
        ratio = gain / spread
        if self.name == "poi":
            return ratio  # a probability rises with its quantile
        density = np.exp(-0.5 * ratio**2) / math.sqrt(2.0 * math.pi)
        return np.asarray(gain * 0.5 * _erfc(-ratio / math.sqrt(2.0)) + spread * density)


@dataclass(frozen=True)
class _Search:
    """Search along the ellipses of M chains, after J turns.

    Attributes:
        other: (M, steps + 1, noise_size) second axis of the ellipse.
        angle: (M, J + 2) angles tried, after the chain's own at 0 and 2 pi.
        score: (M, J + 2) their scores.
        last: (M,) the present proposal is the chain's next point, not one to learn from.
        round: (M,) rounds that have ended.
        begun: (M,) turns before the present round.
    """

    other: Floats
    angle: Floats
    score: Floats
    last: Bools
    round: Integers
    begun: Integers


class BayesianKernel(Kernel):
    """Algorithm 1: one Gaussian process for each step of each chain.

    Args:
        acquisition: Chooses the angles.
        points: Rollouts of a round of optimisation, N_BO.
        uncertainty: A round ends early once the process is nowhere less certain than this, in standard
            deviations of the scores so far, and lies above the level somewhere; 0: never.
    """

    name = "bayesian"
    note = (
        "kernel bayesian is a heuristic: where its surrogate is wrong chains leave the level, and the "
        "estimate is biased"
    )

    def __init__(
        self, acquisition: Acquisition | None = None, points: int = 6, uncertainty: float = 0.0
    ) -> None:
        self.acquisition = acquisition or Acquisition()
        self.points, self.uncertainty = points, uncertainty
        self.rollouts = points + 1.0

    def start(self, tuning: object, state: Points, level: Floats, draw: Draw) -> Move:
        # The chain's own score is known at 0 and 2 pi (lines 1-6).
        score = np.repeat(np.where(np.isfinite(state.score), state.score, 0.0)[:, None], 2, axis=1)
        angle = np.tile([0.0, _CIRCLE], (len(level), 1))
        none, zeros = np.zeros(len(level), dtype=bool), np.zeros(len(level), dtype=np.int64)
        search = _Search(draw.tapes(), angle, score, none, zeros, zeros)
        move = Move.begin(state, level, draw, state.tape, search)
        posterior = Posterior.fit(angle, score)
        return self._propose(move, posterior.most_promising(self.acquisition), none)

    def tell(self, move: Move, points: Points) -> Move:
        # Learn from the proposals, or go there; a round ends with a draw where the mean is high.
        work, rows = move.work, move.waiting
        score = np.where(np.isfinite(points.score), points.score, work.score[rows].min(axis=1))
        column = np.zeros((len(move.level), 1))
        column[rows, 0] = score
        work = replace(work, score=np.concatenate([work.score, column], axis=1))
        going = work.last[rows] & (points.violated | np.isfinite(points.score))
        ended = work.last[rows]
        rows = rows[~ended]
        move = replace(move.accept(going, points), work=work, waiting=rows)
        return self._next(move) if len(rows) else move.stay()

    def _next(self, move: Move) -> Move:
        work, rows = move.work, move.waiting
        posterior = Posterior.fit(work.angle[rows], work.score[rows])
        active = posterior.mean >= posterior.standardise(move.level[rows])[:, None]
        valid = active.any(axis=1)  # line 15
        full = move.turn - work.begun[rows] >= self.points  # line 8
        ends = full | (valid & (posterior.spread.max(axis=1) <= self.uncertainty))
        rounds = work.round[rows] + ends
        first, later = (
            posterior.most_promising(acquisition)
            for acquisition in (self.acquisition, self.acquisition.exploiting())
        )
        most_rounds = 3
        last = ends & (valid | (rounds >= most_rounds))
        uniforms = move.draw.uniforms(rows, move.turn)
        drawn = np.where(valid, _uniform_on_cells(active, uniforms), 0.0)  # no such angle: stay
        angle = np.where(last, drawn, np.where(rounds == 0, first, later))
        counted, begun = work.round.copy(), work.begun.copy()
        counted[rows], begun[rows] = rounds, np.where(ends, move.turn, work.begun[rows])
        return self._propose(replace(move, work=replace(work, round=counted, begun=begun)), angle, last)

    def _propose(self, move: Move, angle: Floats, last: Bools) -> Move:
        rows, work = move.waiting, move.work
        column = np.zeros((len(move.level), 1))
        column[rows, 0] = angle
        flags = work.last.copy()
        flags[rows] = last
        work = replace(work, angle=np.concatenate([work.angle, column], axis=1), last=flags)
        proposal = rotate(move.state.tape[rows], work.other[rows], angle)
        turn = work.angle.shape[1] - 2
        return replace(move, proposal=proposal, turn=turn, work=work)


def _uniform_on_cells(active: Bools, uniforms: Floats) -> Floats:
    # Line 17; ``active`` is (W, G).
    count = np.cumsum(active, axis=1)
    place = uniforms * count[:, -1]
    cell = np.minimum((count <= place[:, None]).sum(axis=1), len(GRID) - 1)
    return np.asarray(GRID[cell] + (place - np.floor(place) - 0.5) * (_CIRCLE / len(GRID)))


@dataclass(frozen=True)
class Posterior:
    """Gaussian process of W ellipses, of scores less their middle and over their scale (line 14).

    Attributes:
        middle: (W,) mean of the scores so far.
        scale: (W,) their standard deviation.
        best: (W,) the largest of them, standardised.
        mean: (W, G) mean of the process on ``GRID``.
        spread: (W, G) its standard deviation.
    """

    middle: Floats
    scale: Floats
    best: Floats
    mean: Floats
    spread: Floats

    @staticmethod
    def fit(angle: Floats, score: Floats) -> Posterior:
        """Return the process given scores (W, J) at angles (W, J)."""
        middle, scale = score.mean(axis=1), np.maximum(score.std(axis=1), 1e-9)
        values = (score - middle[:, None]) / scale[:, None]
        among = _matern_52(angle[:, :, None] - angle[:, None, :]) + 1e-4 * np.eye(angle.shape[1])
        across = _matern_52(angle[:, :, None] - GRID)
        weights = np.linalg.solve(among, across)
        mean = (weights * values[:, :, None]).sum(axis=1)
        variance = 1.0 - (weights * across).sum(axis=1)
        return Posterior(middle, scale, values.max(axis=1), mean, np.sqrt(np.maximum(variance, 0.0)))

    def standardise(self, score: Floats) -> Floats:
        """Return scores (W,), standardised."""
        return np.asarray((score - self.middle) / self.scale)

    def most_promising(self, acquisition: Acquisition) -> Floats:
        """Return the angle (W,) of the largest acquisition (line 10)."""
        return np.asarray(GRID[np.argmax(acquisition(self.mean, self.spread, self.best), axis=1)])


def _matern_52(distance: Floats) -> Floats:
    length_scale = 1.0  # length scale of the process, radians
    r = np.sqrt(5.0) * np.abs(distance) / length_scale
    return np.asarray((1.0 + r + r**2 / 3.0) * np.exp(-r))


class GrowingLipschitzKernel(Elimination):
    """Algorithm 2: one slope per radian for all ellipses of a run, a guess that grows.

    The tuning is the bound (R,) on the slope, score per radian.
    """

    name = "lipschitz_growing"
    note = (
        "kernel lipschitz_growing is a heuristic: its guess of the slope may rule out parts of the level's "
        "set, and the estimate is biased, mostly upwards"
    )

    def __init__(self, guess: float) -> None:
        self.guess = guess

    def init(self, runs: int) -> Floats:
        return np.full(runs, self.guess)

    def start(self, tuning: Floats, state: Points, level: Floats, draw: Draw) -> Move:
        return self.begin(state, level, draw, draw.tapes(), tuning)

    def adapt(self, tuning: Floats, outcome: StepOutcome) -> Floats:
        bound = tuning.copy()
        np.maximum.at(bound, outcome.run, outcome.work.bound)
        return bound
