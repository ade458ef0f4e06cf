"""Levels of splitting: which particles a stage discards and where their successors branch.

Generalised adaptive multilevel splitting (Brehier et al. 2016, "Unbiasedness of some generalized adaptive
multilevel splitting algorithms"): particles are ordered by (score, violated); the level is the K-th of them;
all at or below it are discarded, ties included; a successor branches where its parent first lies strictly
above. No decision at a level depends on the courses above it, and a failure that its score has put below the
level counts with the weight it had: the estimate is unbiased for any formula and score.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers


@dataclass(frozen=True)
class Level:
    """The next level of R runs of N particles.

    Attributes:
        score: (R,) score of the K-th particle.
        reached: (R,) the K-th particle is a failure: the run is done.
        discarded: (R, N) the particle lies at or below the level.
    """

    score: Floats
    reached: Bools
    discarded: Bools


def next_level(score: Floats, violated: Bools, discard: int) -> Level:
    """Return the next level of each run.

    Args:
        score: (R, N) final scores.
        violated: (R, N) the particle is a failure.
        discard: K.
    """
    order = np.lexsort((violated, score), axis=-1)
    kth = order[:, discard - 1 : discard]
    level = np.take_along_axis(score, kth, axis=1)
    reached = np.take_along_axis(violated, kth, axis=1)[:, 0]
    return Level(level[:, 0], reached, (score < level) | ((score == level) & ~violated))


def first_above(scores: Floats, level: Floats) -> Integers:
    """Return the first step (M,) at which running scores (M, T + 1) lie strictly above levels (M,).

    A failure that ties with the level lies above it only by its verdict, which is known at the last step.
    """
    above = scores > level[:, None]
    return np.asarray(np.where(above.any(axis=1), above.argmax(axis=1), scores.shape[1] - 1))


def choose_parents(eligible: Bools, runs: Integers, uniforms: Floats) -> Integers:
    """Choose a slot (M,) uniformly among the eligible slots of each child's run.

    Args:
        eligible: (R, N) at least one in every run that occurs.
        runs: (M,) run of each child.
        uniforms: (M,) in (0, 1).
    """
    particles = eligible.shape[1]
    first = np.argsort(~eligible, axis=1, kind="stable")
    count = eligible.sum(axis=1)[runs]
    pick = np.minimum((uniforms * count).astype(np.int64), count - 1)
    return np.asarray(runs * particles + first[runs, pick], dtype=np.int64)
