"""Does a kernel leave the law of a level's set as it is? From exact starts the scores must not drift.

For whoever writes a kernel: chains that start as exact draws from the set are moved a few steps; if the
kernel is valid, mean and mean square of their scores stay what they were, but for chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare import batch
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare_estimators.chains import Draw, Kernel, Points

_BLOCK = 20_000
"""Tapes drawn at once in search of starts."""


@dataclass(frozen=True)
class Drift:
    """What has become of the chains.

    Attributes:
        mean: Change of the mean score, in standard errors.
        square: Change of the mean squared score, in standard errors.
        outside: Share of the chains that have left the set.
        rollouts: Per chain and step.
        accepted: Share of the steps in which a chain has taken a proposal.
    """

    mean: float
    square: float
    outside: float
    rollouts: float
    accepted: float


def exact_starts(problem: Problem, level: float, many: int, seed: int = 0) -> Points:
    """``many`` independent tapes of the set above ``level``, by rejection.

    Args:
        problem: Whose set is not rare.
        level: Of the score.
        many: M.
        seed: Of the draws.
    """
    noise, found, count, first = NoiseSource(seed, problem.noise_size), [], 0, 0
    while count < many:
        index = np.arange(first, first + _BLOCK)
        tape = noise.normals(0, 0, index[:, None], np.arange(problem.steps + 1))
        points = rolled_out(problem, tape)
        good = points.above(np.full(_BLOCK, level))
        found.append(batch.take(points, good))
        count, first = count + int(good.sum()), first + _BLOCK
    return batch.take(batch.concatenate(found), slice(0, many))


def drift(
    problem: Problem, kernel: Kernel, known: Any, starts: Points, level: float, steps: int = 10, seed: int = 1
) -> Drift:
    """Move exact ``starts`` by some steps of ``kernel``.

    Args:
        problem: With the score that levels are of.
        kernel: To be judged.
        known: What it has learnt, one row, frozen.
        starts: From ``exact_starts``.
        level: The same.
        steps: Of every chain.
        seed: Of the kernel's random numbers; another than that of the starts.
    """
    many = len(starts.score)
    noise, zeros = NoiseSource(seed, problem.noise_size), np.zeros(many, dtype=np.int64)
    known, state, asked, accepted = batch.take(known, zeros), starts, 0, 0
    for step in range(steps):
        draw = Draw(noise, problem.steps, zeros, 1 + step, np.arange(many))
        move = kernel.start(known, state, np.full(many, level), draw)
        while len(move.waiting):
            asked += len(move.waiting)
            move = kernel.tell(move, rolled_out(problem, move.proposal))
        state, accepted = move.state, accepted + int(move.accepted.sum())
    before, after = starts.score, state.score
    return Drift(
        _surprise(after - before),
        _surprise(after**2 - before**2),
        float((~state.above(np.full(many, level))).mean()),
        asked / (many * steps),
        accepted / (many * steps),
    )


def rolled_out(problem: Problem, tape: Floats) -> Points:
    """The points of given tapes (M, steps + 1, noise_size)."""
    rollouts = problem.simulate(NoiseSource(0, problem.noise_size), Request.replay(tape))
    return Points.of(tape, rollouts, np.arange(len(tape)))


def _surprise(change: Floats) -> float:
    """Mean over its standard error."""
    error = float(change.std(ddof=1)) / math.sqrt(len(change))
    return float(change.mean()) / error if error > 0.0 else 0.0
