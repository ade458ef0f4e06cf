"""Probe for failures that one extreme noise number decides, which a rare-event estimate may never meet.

A start that is drawn once in ten thousand, or an outlier that breaks the rule by itself, shows in no score
beforehand. A few rollouts with one number drawn from the tail of its law tell how often it fails then, and so
how likely such failures are at least. They are no part of any estimate: where they contradict its interval,
the estimate has missed them.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from avrare.estimation import intervals
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.stack.noise_names import find_noise_names

_FIRST, _SECOND = 5, 96
"""Rollouts of each tail at first, and of all together that are looked at again."""
_MOST_TAILS = 8
"""Tails that are looked at again."""
_DEPTH = 5.0
"""Probability of a tail over the estimate's upper end."""
_LARGEST_TAIL = 0.05
_RUN = 2**31 + 2**30
"""Address of the probe's noise, far from the runs that count."""


@dataclass(frozen=True)
class Outliers:
    """Failures that one extreme noise number decides.

    Attributes:
        noise: Name of the noise that fails most.
        at_start: It is that of the first step.
        low: Lower end of the interval of their probability.
    """

    noise: str
    at_start: bool
    low: float


def probe_cost(problem: Problem) -> int:
    """Return the most rollouts of a probe."""
    return _FIRST * len(_tails(problem)) + _SECOND


def probe_outliers(
    problem: Problem, column: int, upper: float, seed: int, confidence: float
) -> Outliers | None:
    """Return failures by one outlier whose probability lies above ``upper``; None where there are none.

    A tail is a channel, a side, and the first step or one of the later ones; it has the probability
    ``_DEPTH * upper`` (the chance that a number lies so far out, at any of its steps). With h failures in n
    rollouts that begin with such a number, about h / n of that probability is failure. Tails are chosen by
    the first rollouts, and judged by fresh ones.

    Args:
        problem: The problem.
        column: Number of the specification.
        upper: Upper end of the estimate's interval.
        seed: Seed of the estimate.
        confidence: Level of the interval.
    """
    tails = _tails(problem)
    size = min(_DEPTH * upper, _LARGEST_TAIL)
    # 1. A few rollouts of each tail.
    first = _failures(problem, column, np.repeat(tails, _FIRST, axis=0), size, seed, stage=0)
    hits = first.reshape(len(tails), _FIRST).sum(axis=1)
    worst = np.argsort(-hits, kind="stable")[:_MOST_TAILS]
    worst = worst[hits[worst] > 0]
    if not len(worst):
        return None
    # 2. More of those that failed; only these count.
    again = np.repeat(tails[worst], _SECOND // len(worst), axis=0)
    second = _failures(problem, column, again, size, seed, stage=1)
    low = intervals.clopper_pearson(int(second.sum()), len(second), confidence)[0] * size * len(worst)
    if low <= upper:
        return None
    late, channel, _ = tails[worst[second.reshape(len(worst), -1).sum(axis=1).argmax()]]
    return Outliers(find_noise_names(problem.system)[channel], not late, low)


def _tails(problem: Problem) -> Integers:
    """Return the tails (G, 3): whether at later steps, channel, side."""
    late = (0, 1) if problem.steps else (0,)
    return np.array([(k, c, s) for k in late for c in range(problem.noise_size) for s in (-1, 1)]).reshape(
        -1, 3
    )


def _failures(problem: Problem, column: int, tails: Integers, size: float, seed: int, stage: int) -> Bools:
    """Return which rollouts fail whose tapes have one number from the tails (M, 3)."""
    found = []
    for begin in range(0, len(tails), problem.chunk):
        part = tails[begin : begin + problem.chunk]
        outcome = problem.replay(_tapes(problem, part, begin, size, seed, stage))
        found.append(outcome.violated[:, column] & ~outcome.error)
    return np.concatenate(found)


def _tapes(problem: Problem, tails: Integers, begin: int, size: float, seed: int, stage: int) -> Floats:
    noise = NoiseSource(seed, problem.noise_size, _RUN)
    rows = np.arange(begin, begin + len(tails))
    tape = noise.normals(0, stage, rows[:, None], np.arange(problem.steps + 1))
    uniform = noise.choices(np.zeros_like(rows), np.full(len(rows), stage), rows, 2)
    late, channel, side = tails.T
    step = np.where(late, 1 + (uniform[:, 0] * problem.steps).astype(np.int64), 0)
    share = uniform[:, 1] * size / np.where(late, max(problem.steps, 1), 1)
    quantile = NormalDist().inv_cdf
    tape[np.arange(len(rows)), step, channel] = side * np.array([-quantile(u) for u in share.tolist()])
    return tape
