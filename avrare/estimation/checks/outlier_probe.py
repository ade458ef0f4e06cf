"""Probe for failures that one extreme noise number decides, which a rare-event estimate may never meet.

A start that is drawn once in ten thousand, or an outlier that breaks the rule alone, shows in no score
beforehand. A few rollouts with one number drawn from the tail of its law show how often it fails then, and so
a least probability of these failures. They do not count in the estimate: where they contradict its interval,
the estimate has missed them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist

import numpy as np

from avrare.estimation.result import intervals
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare.stack.part_checks import find_noise_names

_FIRST, _SECOND = 5, 96
"""Rollouts of each tail at first, and of all together that are looked at again."""
DEPTHS = (5.0, 20.0, 100.0)
"""Probabilities of a tail over the estimate's upper end: a fault that seldom fails shows in a large tail."""
LARGEST_TAIL = 0.05


@dataclass(frozen=True)
class Outliers:
    """Failures that one extreme noise number decides, or two together.

    Attributes:
        noise: Name of the noise that fails most.
        step: Step of the number: 0, the start, or 1; None: a later one.
        low: Lower end of the interval of their probability.
    """

    noise: str
    step: int | None
    low: float


def probe_cost(problem: Problem) -> int:
    """Return the most rollouts of a probe."""
    return len(DEPTHS) * _FIRST * len(_tails(problem)) + _SECOND


def probe_outliers(
    problem: Problem, column: int, upper: float, seed: int, confidence: float
) -> Outliers | None:
    """Return failures by one outlier whose probability lies above ``upper``; None where there are none.

    A tail is a channel, a side, and the first step or one of the later ones; it has one of the probabilities
    ``DEPTHS * upper`` (the chance that a number lies so far out, at any of its steps). With h failures in n
    rollouts that begin with this number, about h / n of that probability is failure. Tails are chosen by
    the first rollouts, each at one depth, and judged by fresh ones.

    Args:
        problem: The problem.
        column: Number of the specification.
        upper: Upper end of the estimate's interval.
        seed: Seed of the estimate.
        confidence: Level of the interval.
    """
    tails, sizes = _tails(problem), np.minimum(np.multiply(DEPTHS, upper), LARGEST_TAIL)
    # 1. A few rollouts of each tail at each depth.
    pairs = np.repeat(np.stack(np.divmod(np.arange(len(tails) * len(sizes)), len(sizes))), _FIRST, axis=1)
    draw = partial(_tapes, problem, seed)
    first = find_failures(problem, column, tails[pairs[0]], partial(draw, 0, sizes[pairs[1]]))
    hits = first.reshape(len(tails), len(sizes), _FIRST).sum(axis=2)
    promise = hits**3 * sizes  # a large tail with a lucky hit is judged poorly
    deepest = promise.argmax(axis=1)
    worst = np.argsort(-promise.max(axis=1), kind="stable")[:8]
    worst = worst[hits[worst].any(axis=1)]
    if not len(worst):
        return None
    # 2. More of those that failed, each at its depth; only these count.
    each = _SECOND // len(worst)
    again, size = np.repeat(tails[worst], each, axis=0), np.repeat(sizes[deepest[worst]], each)
    second = find_failures(problem, column, again, partial(draw, 1, size))
    hits, level = second.reshape(len(worst), each).sum(axis=1), 1.0 - (1.0 - confidence) / len(worst)
    shares = [intervals.clopper_pearson(count, each, level)[0] for count in hits.tolist()]
    lows = np.multiply(shares, sizes[deepest[worst]])
    low = float(lows.sum())
    if low <= upper:
        return None
    late, channel, _ = tails[worst[lows.argmax()]]
    return Outliers(find_noise_names(problem.system)[channel], None if late else 0, low)


def _tails(problem: Problem) -> Integers:
    """Return the tails (G, 3): whether at later steps, channel, side."""
    late = (0, 1) if problem.steps else (0,)
    return np.array([(k, c, s) for k in late for c in range(problem.noise_size) for s in (-1, 1)]).reshape(
        -1, 3
    )


def find_failures(
    problem: Problem, column: int, wanted: Integers, tapes: Callable[[Integers, Integers], Floats]
) -> Bools:
    """Return which rollouts (M,) fail; one that breaks down does not.

    Args:
        problem: The problem.
        column: Number of the specification.
        wanted: Extreme entries of each tape (M, ...).
        tapes: Function of some numbers of rollouts (m,) and their part of ``wanted`` to tapes (m, T + 1, C).
    """
    failing = []
    for begin in range(0, len(wanted), problem.chunk):
        part = wanted[begin : begin + problem.chunk]
        outcome = problem.replay(tapes(np.arange(begin, begin + len(part)), part))
        failing.append(outcome.violated[:, column] & ~outcome.error)
    return np.concatenate(failing)


def _tapes(problem: Problem, seed: int, stage: int, sizes: Floats, rows: Integers, tails: Integers) -> Floats:
    """Return tapes (M, T + 1, C) with one number from the tails (M, 3), of probabilities ``sizes[rows]``."""
    noise = NoiseSource(seed, problem.noise_size, 2**31 + 2**30)  # far from the noise of the runs that count
    tape = noise.normals(0, stage, rows[:, None], np.arange(problem.steps + 1))
    uniform = noise.choices(np.zeros_like(rows), np.full(len(rows), stage), rows, 2)
    late, channel, side = tails.T
    step = np.where(late, 1 + (uniform[:, 0] * problem.steps).astype(np.int64), 0)
    share = uniform[:, 1] * sizes[rows] / np.where(late, max(problem.steps, 1), 1)
    quantile = NormalDist().inv_cdf
    tape[np.arange(len(rows)), step, channel] = side * np.array([-quantile(u) for u in share.tolist()])
    return tape
