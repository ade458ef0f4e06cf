"""Statistics of one estimator's repetitions (docs/compare.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from avrare.analysis.compare.case import GroundTruth
from avrare.base.special_functions import t_factor
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare.protocols import Floats

MIN_REPETITIONS = 2
"""Repetitions that a spread needs."""


@dataclass(frozen=True)
class Accuracy:
    """Distance of the repetitions from the truth."""

    ratio: float  # mean estimate over truth
    covered: int  # repetitions whose interval contains the truth
    covered_interval: Interval  # of their share (Clopper and Pearson)
    relative_rmse: float  # root of the mean of (estimate / truth - 1)^2
    work: float  # its square times the mean cost in full rollouts: the work-normalised variance
    work_interval: Interval | None  # from the spread of the repetitions; None if they are equal
    # no estimate has a failure, or the mean's interval misses the truth and its bias makes up most of the
    # mean squared error
    missed: bool
    # Monte Carlo's ``work`` (1 - p) / p over this one's; None if missed, since more work reduces no bias
    speed_up: float | None
    speed_up_interval: Interval | None


@dataclass(frozen=True)
class Summary:
    """Statistics of an estimator's repetitions."""

    repetitions: int
    mean: float
    interval: Interval | None  # of the mean; None with a single repetition
    steps: float  # mean of a repetition
    rollouts: float  # mean of a repetition
    simulations: float  # mean cost in full rollouts: steps over those of a rollout; rollouts if it has none
    zeros: int  # estimates that are zero
    warned: int  # repetitions with health warnings
    warnings: dict[str, int]  # repetitions by warning
    accuracy: Accuracy | None  # None without a truth, or with a single repetition


def summarise(
    repetitions: Sequence[Result], truth: GroundTruth | None, steps: int, confidence: float
) -> Summary | None:
    """Return the statistics of an estimator; None if it has no repetitions.

    ``steps`` are those of a full rollout.
    """
    if not repetitions:
        return None
    values = np.array([repetition.probability for repetition in repetitions])
    cost = np.array(
        [repetition.simulated_steps / steps if steps else repetition.rollouts for repetition in repetitions]
    )
    names = sorted({name for repetition in repetitions for name in repetition.health})
    several = len(values) >= MIN_REPETITIONS
    return Summary(
        repetitions=len(values),
        mean=float(values.mean()),
        interval=_mean_interval(repetitions, confidence) if several else None,
        steps=float(np.mean([repetition.simulated_steps for repetition in repetitions])),
        rollouts=float(np.mean([repetition.rollouts for repetition in repetitions])),
        simulations=float(cost.mean()),
        zeros=int((values == 0.0).sum()),
        warned=sum(bool(repetition.health) for repetition in repetitions),
        warnings={name: sum(name in repetition.health for repetition in repetitions) for name in names},
        accuracy=_accuracy(repetitions, values, cost, truth, confidence) if truth and several else None,
    )


def find_disagreements(labels: Sequence[str], summaries: Sequence[Summary | None]) -> list[tuple[str, str]]:
    """Return pairs of estimators whose means have disjoint intervals."""
    intervals = [(label, s.interval) for label, s in zip(labels, summaries, strict=True) if s and s.interval]
    return [
        (first, second)
        for (first, a), (second, b) in combinations(intervals, 2)
        if a[1] < b[0] or b[1] < a[0]
    ]


def _accuracy(
    repetitions: Sequence[Result], values: Floats, cost: Floats, truth: GroundTruth, confidence: float
) -> Accuracy:
    p = truth.probability
    squares = (values / p - 1.0) ** 2
    covered = sum(repetition.interval[0] <= p <= repetition.interval[1] for repetition in repetitions)
    work = float(squares.mean() * cost.mean())
    work_interval = _log_delta_interval(squares * cost.mean(), confidence)
    low, high = _mean_interval(repetitions, confidence)
    bias = float(values.mean()) / p - 1.0
    # share of the mean squared error above which a mean whose interval misses the truth counts as biased
    largest_bias_share = 0.5
    missed = not values.any() or (
        not low <= p <= high and bias**2 > largest_bias_share * float(squares.mean())
    )
    monte_carlo = (1.0 - p) / p
    return Accuracy(
        ratio=float(values.mean()) / p,
        covered=covered,
        covered_interval=intervals.clopper_pearson(covered, len(values), confidence),
        relative_rmse=math.sqrt(squares.mean()),
        work=work,
        work_interval=work_interval,
        missed=missed,
        speed_up=None if missed or not work else monte_carlo / work,
        speed_up_interval=None
        if missed or work_interval is None
        else (monte_carlo / work_interval[1], monte_carlo / work_interval[0]),
    )


def _mean_interval(repetitions: Sequence[Result], confidence: float) -> Interval:
    values = np.array([result.probability for result in repetitions])
    mean = float(values.mean())
    if mean == 0.0:
        return intervals.unknown(confidence)
    variance = float(values.var(ddof=1)) / mean**2
    if variance == 0.0:  # all estimates are equal: use their own relative errors
        variances = [
            result.relative_error**2 for result in repetitions if math.isfinite(result.relative_error)
        ]
        variance = float(np.mean(variances)) if variances else 0.0
    return intervals.log_normal(mean, variance / len(values), confidence, freedom=len(values) - 1)


def _log_delta_interval(values: Floats, confidence: float) -> Interval | None:
    # Mean of positive, skewed values (R,), by the delta method on the logarithm; None if they are equal
    mean = float(values.mean())
    if mean == 0.0 or values.min() == values.max():
        return None
    spread = math.log1p(float(values.var(ddof=1)) / (len(values) * mean**2))
    width = t_factor(confidence, len(values) - 1) * math.sqrt(spread)
    return mean * math.exp(-width), mean * math.exp(width)
