"""The statistics of one estimator's repetitions (docs/compare.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from avrare.compare.study import Repetition
from avrare.compare.truth import Truth
from avrare.estimation import intervals
from avrare.estimation.result import Interval
from avrare.protocols import Floats

FEWEST = 2
"""Repetitions without which there is no spread."""
_MOSTLY_BIAS = 0.5
"""Share of the mean squared error above which a mean whose interval misses the truth counts as wrong."""


@dataclass(frozen=True)
class Accuracy:
    """How far the repetitions lie from the truth.

    Attributes:
        ratio: Mean estimate over truth.
        covered: Repetitions whose interval holds the truth.
        covered_interval: Of the share, Clopper and Pearson's.
        relative_rmse: Root of the mean of (estimate / truth - 1)^2.
        work: Its square times the mean cost in full simulations: the work-normalised variance.
        work_interval: Of ``work``, from the spread of the repetitions; None where they do not differ.
        missed: Whether no estimate saw a failure, or the mean's interval misses the truth and most of the
            mean squared error is its distance.
        speed_up: Monte Carlo's ``work`` (1 - p) / p over this one's; None where the mean missed the truth:
            what is wrong with it is no variance, and more work does not mend it.
        speed_up_interval: Of ``speed_up``.
    """

    ratio: float
    covered: int
    covered_interval: Interval
    relative_rmse: float
    work: float
    work_interval: Interval | None
    missed: bool
    speed_up: float | None
    speed_up_interval: Interval | None


@dataclass(frozen=True)
class Summary:
    """What an estimator's repetitions add up to.

    Attributes:
        repetitions: How many there are.
        mean: Of the estimates.
        interval: Of the mean; None with a single repetition.
        steps: Mean simulated steps of a repetition.
        rollouts: Mean rollouts of a repetition.
        simulations: Mean cost in full simulations: steps over those of a rollout; rollouts if it has none.
        zeros: Estimates that are zero.
        warned: Repetitions with health warnings.
        warnings: Repetitions by warning.
        accuracy: None without a truth, or with a single repetition.
    """

    repetitions: int
    mean: float
    interval: Interval | None
    steps: float
    rollouts: float
    simulations: float
    zeros: int
    warned: int
    warnings: dict[str, int]
    accuracy: Accuracy | None


def summarise(
    repetitions: Sequence[Repetition], truth: Truth | None, steps: int, confidence: float
) -> Summary | None:
    """The statistics of an estimator; None if it has no repetitions.

    Args:
        repetitions: Its estimates.
        truth: What they should be.
        steps: Of a full simulation.
        confidence: Of the intervals.
    """
    if not repetitions:
        return None
    values = np.array([one.probability for one in repetitions])
    cost = np.array([one.simulated_steps / steps if steps else one.rollouts for one in repetitions])
    names = sorted({name for one in repetitions for name in one.health})
    many = len(values) >= FEWEST
    return Summary(
        repetitions=len(values),
        mean=float(values.mean()),
        interval=_of_mean(repetitions, confidence) if many else None,
        steps=float(np.mean([one.simulated_steps for one in repetitions])),
        rollouts=float(np.mean([one.rollouts for one in repetitions])),
        simulations=float(cost.mean()),
        zeros=int((values == 0.0).sum()),
        warned=sum(bool(one.health) for one in repetitions),
        warnings={name: sum(name in one.health for one in repetitions) for name in names},
        accuracy=_accuracy(repetitions, values, cost, truth, confidence) if truth and many else None,
    )


def disagreements(labels: Sequence[str], summaries: Sequence[Summary | None]) -> list[tuple[str, str]]:
    """Pairs of estimators whose means have intervals without a common point."""
    known = [(label, s.interval) for label, s in zip(labels, summaries, strict=True) if s and s.interval]
    return [(one, other) for (one, a), (other, b) in combinations(known, 2) if a[1] < b[0] or b[1] < a[0]]


def _accuracy(
    repetitions: Sequence[Repetition], values: Floats, cost: Floats, truth: Truth, confidence: float
) -> Accuracy:
    p = truth.probability
    squares = (values / p - 1.0) ** 2
    covered = sum(one.interval[0] <= p <= one.interval[1] for one in repetitions)
    work = float(squares.mean() * cost.mean())
    span = _delta_log(squares * cost.mean(), confidence)
    low, high = _of_mean(repetitions, confidence)
    bias = float(values.mean()) / p - 1.0
    missed = not values.any() or (not low <= p <= high and bias**2 > _MOSTLY_BIAS * float(squares.mean()))
    gain = (1.0 - p) / p
    return Accuracy(
        ratio=float(values.mean()) / p,
        covered=covered,
        covered_interval=intervals.clopper_pearson(covered, len(values), confidence),
        relative_rmse=math.sqrt(squares.mean()),
        work=work,
        work_interval=span,
        missed=missed,
        speed_up=None if missed or not work else gain / work,
        speed_up_interval=None if missed or span is None else (gain / span[1], gain / span[0]),
    )


def _of_mean(repetitions: Sequence[Repetition], confidence: float) -> Interval:
    """Of the mean of independent estimates; where they are all equal, from their own relative errors."""
    values = np.array([one.probability for one in repetitions])
    mean = float(values.mean())
    if mean == 0.0:
        return intervals.unknown(confidence)
    variance = float(values.var(ddof=1)) / mean**2
    if variance == 0.0:
        known = [one.relative_error**2 for one in repetitions if math.isfinite(one.relative_error)]
        variance = float(np.mean(known)) if known else 0.0
    return intervals.log_normal(mean, variance / len(values), confidence, freedom=len(values) - 1)


def _delta_log(values: Floats, confidence: float) -> Interval | None:
    """Of the mean of positive, skewed values (R,), on a logarithmic scale; None where they do not differ."""
    mean = float(values.mean())
    if mean == 0.0 or values.min() == values.max():
        return None
    spread = math.log1p(float(values.var(ddof=1)) / (len(values) * mean**2))
    width = intervals.t_factor(confidence, len(values) - 1) * math.sqrt(spread)
    return mean * math.exp(-width), mean * math.exp(width)
