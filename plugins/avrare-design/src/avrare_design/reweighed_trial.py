"""Reweighed trial: estimates for nearby values of a parameter from the failures of one run.

Where a parameter changes nothing but the law of the observations, and the density ratio w of two laws
is known, the mean of w over failures, times the probability, is that at the other value. The values must be
fixed before the run, else the estimates would have no interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Failures, Result
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.weighted_problem import log_ratios

HALVING = math.sqrt(math.log(2.0))
"""Standard deviation of normal log weights at which half of the effective failures are left."""


@dataclass(frozen=True)
class Score:
    """Slope of log p, from failures.

    Attributes:
        slope: d log p / d parameter.
        error: Its standard error.
        reach: How far from its value half of the effective failures are left by reweighing.
    """

    slope: float
    error: float
    reach: float


@dataclass(frozen=True)
class Nearby:
    """Estimate at a value that no rollout was run at.

    Attributes:
        value: The value.
        probability: The estimate.
        interval: Its interval.
    """

    value: float
    probability: float
    interval: Interval


@dataclass(frozen=True)
class Reweigher:
    """Reweighs failures of a problem for values of one parameter of its perception error model.

    Attributes:
        problem: The problem at the value that was run.
        value: That value.
        build: Function from a value to the perception error model.
        between: Smallest and largest value that can be built.
    """

    problem: Problem
    value: float
    build: Callable[[float], Any]
    between: tuple[float, float] = (-math.inf, math.inf)

    def score(self, failures: Failures) -> Score | None:
        """Return the slope of log p, and how far the failures can be reweighed.

        It is None where they are too few, or the model knows no density ratio for this parameter.

        The log weights of a nearby value are, to first order, the score times the distance.
        """
        relative_step = 1e-3
        step, count = relative_step * abs(self.value), len(failures.noise)
        if count < 8 or step == 0.0:  # too few failures to know a slope
            return None
        low, high = max(self.value - step, self.between[0]), min(self.value + step, self.between[1])
        ratios = self._ratios(failures, (high, low))
        if ratios is None:
            return None
        with np.errstate(invalid="ignore"):  # what cannot happen at a value has no ratio
            scores = (ratios[:, 0] - ratios[:, 1]) / (high - low)
            spread = float(scores.std(ddof=1))
        if not spread > 0.0 or not math.isfinite(spread):
            return None
        return Score(float(scores.mean()), spread / math.sqrt(count), HALVING / spread)

    def reweigh(self, result: Result, values: Sequence[float], level: float) -> tuple[Nearby, ...]:
        """Return estimates at values that were fixed before the run, where enough failures are left.

        Args:
            result: Estimate at this value; other than by Monte Carlo of a fixed size it does not count.
            values: The values.
            level: Level of the intervals.
        """
        # too few failures to trust their weights
        if len(result.failures.noise) < 20 or not len(values) or not result.trials:
            return ()
        ratios = self._ratios(result.failures, values)
        if ratios is None:
            return ()
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            weights = np.exp(ratios)
            effective = weights.sum(axis=0) ** 2 / (weights**2).sum(axis=0)
        least_share = 0.25  # effective share of the failures that must be left
        return tuple(
            _estimate(float(value), column, result, level)
            for value, column, left in zip(values, weights.T, effective, strict=True)
            if left >= least_share * len(column)
        )

    def _ratios(self, failures: Failures, values: Sequence[float]) -> Floats | None:
        others = [self.build(value) for value in values]
        try:
            return log_ratios(self.problem, others, failures.noise)
        except UsageError:  # the model has ratios, but not for this parameter: estimates stand alone
            return None


def _estimate(value: float, weights: Floats, result: Result, level: float) -> Nearby:
    # The number of failures and the mean weight of those that were kept are independent.
    mean, trials = float(weights.mean()), result.trials
    total = mean * result.failures.count / trials
    relative = 1.0 / result.failures.count + float(weights.var(ddof=1)) / (len(weights) * mean**2)
    largest = max(float(weights.max()), 1.0) / trials
    broken = result.errors * largest, result.errors * largest**2
    interval = intervals.matched_counts((total, relative * total**2), trials, largest, level, broken)
    return Nearby(value, min(total, 1.0), interval)
