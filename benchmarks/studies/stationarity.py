"""Stationarity check of kernels: from exact starts the scores of chains must not drift.

Chains that start as exact draws from a level's set are moved a few steps; if the kernel leaves the law of the
set invariant, mean and mean square of their scores do not change, but for chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare_estimators.common.chains.kernel import Draw, Kernel, Points

_BLOCK = 20_000
"""Number of tapes drawn at once in search of starts."""


@dataclass(frozen=True)
class Drift:
    """Change of the chains.

    Attributes:
        mean: Change of the mean score, in standard errors.
        square: Change of the mean squared score, in standard errors.
        outside: Share of the chains that have left the set.
        rollouts: Rollouts per chain and step.
        accepted: Share of the steps in which a chain has accepted a proposal.
    """

    mean: float
    square: float
    outside: float
    rollouts: float
    accepted: float


def exact_starts(problem: Problem, level: float, chains: int, seed: int = 0) -> Points:
    """Draw independent tapes of the set above ``level``, by rejection.

    Args:
        problem: Problem whose set is not rare.
        level: Level of the score.
        chains: M.
        seed: Seed of the draws.
    """
    noise, found, count, first = NoiseSource(seed, problem.noise_size), [], 0, 0
    while count < chains:
        index = np.arange(first, first + _BLOCK)
        tape = noise.normals(0, 0, index[:, None], np.arange(problem.steps + 1))
        points = rolled_out(problem, tape)
        inside = points.above(np.full(_BLOCK, level))
        found.append(batch.take(points, inside))
        count, first = count + int(inside.sum()), first + _BLOCK
    return batch.take(batch.concatenate(found), slice(0, chains))


def drift(
    problem: Problem,
    kernel: Kernel,
    tuning: Any,
    starts: Points,
    level: float,
    steps: int = 10,
    seed: int = 1,
) -> Drift:
    """Move exact starts by some steps of a kernel.

    Args:
        problem: Problem with the score of the level.
        kernel: Kernel to be judged.
        tuning: What it has learnt, one row, frozen.
        starts: Points from ``exact_starts``.
        level: Level of the starts.
        steps: Steps of every chain.
        seed: Seed of the kernel's random numbers, different from that of the starts.
    """
    many = len(starts.score)
    noise, zeros = NoiseSource(seed, problem.noise_size), np.zeros(many, dtype=np.int64)
    tuning, state, asked, accepted = batch.take(tuning, zeros), starts, 0, 0
    for step in range(steps):
        draw = Draw(noise, problem.steps, zeros, 1 + step, np.arange(many))
        move = kernel.start(tuning, state, np.full(many, level), draw)
        while len(move.waiting):
            asked += len(move.waiting)
            move = kernel.tell(move, rolled_out(problem, move.proposal))
        state, accepted = move.state, accepted + int(move.accepted.sum())
    before, after = starts.score, state.score
    return Drift(
        _z_score(after - before),
        _z_score(after**2 - before**2),
        float((~state.above(np.full(many, level))).mean()),
        asked / (many * steps),
        accepted / (many * steps),
    )


def rolled_out(problem: Problem, tape: Floats) -> Points:
    """Return the points of given tapes (M, steps + 1, noise_size)."""
    rollouts = problem.simulate(NoiseSource(0, problem.noise_size), Request.replay(tape))
    return Points.of(tape, rollouts, np.arange(len(tape)))


def _z_score(change: Floats) -> float:
    error = float(change.std(ddof=1)) / math.sqrt(len(change))
    return float(change.mean()) / error if error > 0.0 else 0.0
