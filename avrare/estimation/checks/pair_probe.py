"""Probe for failures that two extreme noise numbers of a step decide together (see ``outlier_probe``).

There are too many pairs to try each. Rollouts in which many numbers of the step are extreme tell whether
there is one; of those that fail, each pair is tried.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import combinations
from statistics import NormalDist

import numpy as np

from avrare.estimation.checks.outlier_probe import DEPTHS, LARGEST_TAIL, Outliers, find_failures
from avrare.estimation.result import intervals
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.stack.part_checks import find_noise_names

_GROUPS, _MOST_GROUPS = 24, 64
"""Rollouts with many extreme numbers, of few numbers and at most."""
_LOOKED_AT, _SECOND = 3, 48
"""Those of them whose pairs are tried, and rollouts of the pair that is tried again."""
_FEW, _LEAST, _MOST = 40, 2, 6
"""Rollouts of all pairs of a group at first, about; the least and the most of a pair."""
_TOGETHER = 12
"""Numbers that are extreme together, about, at most."""


def pair_probe_cost(problem: Problem) -> int:
    """Return the most rollouts of a probe, about."""
    size = problem.noise_size
    if size < 2:
        return 0
    first = _LOOKED_AT * _count_pairs(size) * _count_tries(size)
    return len(_steps(problem)) * (_count_groups(size) + first + _SECOND)


def probe_pairs(problem: Problem, column: int, upper: float, seed: int, confidence: float) -> Outliers | None:
    """Return failures by two outliers of a step whose probability lies above ``upper``; None without any.

    The steps are the start and the first one. Two numbers lie in tails of probability q each, on given sides,
    with probability q^2, which is that of a tail in ``probe_outliers``. With h failures in n such rollouts,
    about h / n of it is failure. The pair is chosen by the first rollouts, and judged by fresh ones.

    Args:
        problem: The problem.
        column: Number of the specification.
        upper: Upper end of the estimate's interval.
        seed: Seed of the estimate.
        confidence: Level of the interval.
    """
    if problem.noise_size < 2:
        return None
    size, tries = min(DEPTHS[0] * upper, LARGEST_TAIL), _count_tries(problem.noise_size)
    for step in _steps(problem):
        draw = _Tails(problem, seed, step, math.sqrt(size))
        # 1. Rollouts with many extreme numbers.
        groups = draw.sides_of_groups()
        failing = groups[find_failures(problem, column, groups, partial(draw.tapes, 0))][:_LOOKED_AT]
        # 2. The pairs of those that fail.
        pairs = _pairs_of(failing)
        if not len(pairs):
            continue
        repeated = np.repeat(pairs, tries, axis=0)
        first = find_failures(problem, column, repeated, partial(draw.tapes, 1))
        hits = first.reshape(len(pairs), tries).sum(axis=1)
        if not hits.any():
            continue
        # 3. Fresh rollouts of the pair that fails most; only these count.
        pair = pairs[hits.argmax()]
        repeated_pair = np.tile(pair, (_SECOND, 1))
        second = find_failures(problem, column, repeated_pair, partial(draw.tapes, 2))
        low = intervals.clopper_pearson(int(second.sum()), _SECOND, confidence)[0] * size
        if low > upper:
            names = find_noise_names(problem.system)
            noise = "` and `".join(names[channel] for channel in np.flatnonzero(pair))
            return Outliers(noise, step, low)
    return None


def _steps(problem: Problem) -> tuple[int, ...]:
    return (0, 1) if problem.steps else (0,)


def _count_groups(channels: int) -> int:
    """Return the groups: two of more channels are more seldom extreme together."""
    return math.ceil(min(_MOST_GROUPS, _GROUPS * max(1.0, channels / _TOGETHER) ** 2))


def _count_pairs(channels: int) -> int:
    """Return the pairs of a group, about."""
    return math.comb(min(channels, _TOGETHER), 2)


def _count_tries(channels: int) -> int:
    """Return the first rollouts of a pair."""
    return min(_MOST, max(_LEAST, _FEW // _count_pairs(channels)))


def _pairs_of(groups: Integers) -> Integers:
    """Return the different pairs (P, C) of extreme numbers in groups of them (G, C), as sides."""
    signed_pairs = {
        (a, int(sides[a]), b, int(sides[b]))
        for sides in groups
        for a, b in combinations(np.flatnonzero(sides), 2)
    }
    pairs = np.zeros((len(signed_pairs), groups.shape[1]), dtype=np.int64)
    for row, (a, side, b, other) in enumerate(sorted(signed_pairs)):
        pairs[row, a], pairs[row, b] = side, other
    return pairs


class _Tails:
    """Tapes whose numbers of a step are drawn from tails of probability ``size``."""

    def __init__(self, problem: Problem, seed: int, step: int, size: float) -> None:
        self.problem, self.step, self.size = problem, step, size
        # far from the noise of the runs that count
        self.noise = NoiseSource(seed, problem.noise_size, 2**31 + 2**30 + 1 + step)

    def sides_of_groups(self) -> Integers:
        """Return sides (G, C), 0 for a number that is not extreme."""
        channels = self.problem.noise_size
        rows = np.arange(_count_groups(channels))
        uniform = self.noise.choices(np.zeros_like(rows), np.full_like(rows, 3), rows, channels)
        share = min(1.0, _TOGETHER / channels)
        return np.where(uniform < share, np.where(uniform < 0.5 * share, -1, 1), 0)

    def tapes(self, stage: int, rows: Integers, sides: Integers) -> Floats:
        """Return tapes (M, T + 1, C) with numbers from the tails on these sides (M, C)."""
        quantile = NormalDist().inv_cdf
        tape = self.noise.normals(0, stage, rows[:, None], np.arange(self.problem.steps + 1))
        uniform = self.noise.choices(np.zeros_like(rows), np.full(len(rows), stage), rows, sides.shape[1])
        row, channel = np.nonzero(sides)
        extreme = [-quantile(u) for u in (self.size * uniform[row, channel]).tolist()]
        tape[row, self.step, channel] = sides[row, channel] * np.array(extreme)
        return tape
