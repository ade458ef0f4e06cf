"""Sample of failures with the weight of each: the base of shares and means over failures.

Monte Carlo keeps independent failures that weigh the same. Importance sampling keeps weighted ones, and
splitting keeps copies of a few first ancestors in each run: their means have an error of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.special_functions import normal_factor, t_factor
from avrare.estimation.result import intervals
from avrare.estimation.result.doubts import DOUBTS
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Failures, Result
from avrare.protocols import Bools, Floats


@dataclass(frozen=True)
class ModelInterval:
    """Interval of an estimate over an ensemble, which includes that the model is not known.

    Attributes:
        interval: The interval.
        confidence: Its level.
        members: Models that were drawn, K.
    """

    interval: Interval
    confidence: float
    members: int

    def distances(self, probability: float, confidence: float) -> tuple[float, float]:
        """Return how far its ends lie from the estimate in log p, at another level as a t law widens it."""
        freedom = max(1, self.members - 1)
        factor = t_factor(confidence, freedom) / t_factor(self.confidence, freedom)
        low, high = self.interval
        below = math.log(probability / low) if low > 0.0 else math.inf
        return factor * max(below, 0.0), factor * max(math.log(high / probability), 0.0)


@dataclass(frozen=True)
class FailureSample:
    """Failures of one estimate.

    Attributes:
        failures: The kept failures.
        probability: The estimate.
        relative_error: Its relative standard error.
        trials: Rollouts of which ``failures.count`` failed independently; 0 for other estimators.
        runs: Number of runs.
        errors: Rollouts that broke down.
        confidence: Level of the intervals.
        model: Interval over an ensemble of models; None where there was none.
        opened_at: Interval of a doubted estimate at a confidence, than which no part is surer; else None.
    """

    failures: Failures
    probability: float
    relative_error: float
    trials: int
    runs: int
    errors: int
    confidence: float
    model: ModelInterval | None = None
    opened_at: Callable[[float], Interval] | None = None

    @staticmethod
    def of(result: Result) -> FailureSample:
        """Return the sample of a result.

        Raises:
            UsageError: It keeps no failure.
        """
        if not len(result.failures.robustness):
            raise UsageError(
                f"{result.specification}: no failure is kept, so nothing can be said of its causes",
                "run more rollouts, or an estimator for rare events",
            )
        model = ModelInterval(result.interval, result.confidence, result.members) if result.members else None
        doubted = result.unopened_at is not None or bool(DOUBTS.intersection(result.health))
        return FailureSample(
            result.failures,
            result.probability,
            result.relative_error,
            result.trials,
            len(result.run_probabilities),
            result.errors,
            result.confidence,
            model,
            result.interval_at if doubted else None,
        )

    def take(self, rows: NDArray[np.int64]) -> FailureSample:
        """Return the sample reduced to some of the failures, which represent all."""
        failures = self.failures
        weights = None if failures.weights is None else failures.weights[rows]
        if weights is not None and weights.any():
            weights = weights * (self.probability / weights.sum())
        ancestors = None if failures.ancestors is None else failures.ancestors[rows]
        fewer = Failures(failures.noise[rows], failures.robustness[rows], failures.count, weights, ancestors)
        return replace(self, failures=fewer)

    @property
    def size(self) -> int:
        """Number of kept failures, F."""
        return len(self.failures.robustness)

    @cached_property
    def shares(self) -> Floats:
        """(F,) share of the probability that each failure represents; they add up to 1."""
        weights = self.failures.weights
        if weights is None or not weights.any():
            return np.full(self.size, 1.0 / self.size)
        return np.asarray(weights / weights.sum())

    @cached_property
    def clusters(self) -> NDArray[np.int64]:
        """(F,) number of the independent piece that each failure belongs to: its run, or its ancestor."""
        ancestors = self.failures.ancestors
        if ancestors is None:
            return np.arange(self.size)
        key = ancestors[:, :1] if self.runs > 1 else ancestors
        return np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)

    def count_ancestors(self, rows: Bools) -> int:
        """Return the number of first ancestors among some of the failures."""
        ancestors = self.failures.ancestors
        return int(rows.sum()) if ancestors is None else len(np.unique(ancestors[rows], axis=0))

    def mean(self, values: Floats) -> tuple[float, float, int]:
        """Return the mean over failures of ``values`` (F,), its standard error and degrees of freedom.

        The mean is a ratio estimator; its error is that of the linearised ratio over independent pieces.
        """
        mean = float(self.shares @ values)
        pieces = np.bincount(self.clusters, self.shares * (values - mean))
        weight = np.bincount(self.clusters, self.shares)
        count = len(pieces)
        if count < 2:
            return mean, math.inf, 1
        effective = 1.0 / float((weight**2).sum())
        error = math.sqrt(float((pieces**2).sum()) * count / (count - 1))
        return mean, error, max(1, round(effective) - 1)

    def mean_interval(self, values: Floats) -> tuple[float, Interval]:
        """Return the mean over failures of ``values`` (F,) and its t interval."""
        mean, error, freedom = self.mean(values)
        half = t_factor(self.confidence, freedom) * error
        return mean, (mean - half, mean + half)

    def share_interval(self, chosen: Bools, confidence: float | None = None) -> tuple[float, Interval]:
        """Return the share of the ``chosen`` (F,) failures, with its interval in [0, 1].

        Independent failures of equal weight give the exact binomial interval. Others are counted as their
        effective number: share (1 - share) over the variance of the ratio, at most the number of pieces.
        """
        level = self.confidence if confidence is None else confidence
        share, error, _ = self.mean(chosen.astype(np.float64))
        share = float(chosen[0]) if chosen.all() or not chosen.any() else share  # without rounding
        size = self.size
        if self.failures.weights is not None or self.failures.ancestors is not None:
            pieces = 1.0 / float((np.bincount(self.clusters, self.shares) ** 2).sum())
            resolved = 0.0 < share < 1.0 and math.isfinite(error) and error > 0.0
            effective = min(share * (1.0 - share) / error**2, pieces) if resolved else pieces
            size = max(1, math.floor(effective))
        low, high = intervals.clopper_pearson(math.floor(share * size + 1e-9), size, level)
        if share * size % 1.0 > 1e-9:  # between two counts: both ends as of the nearer one outwards
            high = intervals.clopper_pearson(math.ceil(share * size - 1e-9), size, level)[1]
        return share, (min(low, share), max(high, share))

    def part_interval(self, chosen: Bools) -> tuple[float, Interval]:
        """Return the probability of the failures ``chosen`` (F,) and its interval.

        Where the estimate is doubted, all that it may have missed may belong to them.
        """
        share = 1.0 if chosen.all() else float(self.shares[chosen].sum())
        part, (low, high) = self._measure_part(chosen, share)
        if self.opened_at is None:
            return part, (low, high)
        lowest, highest = self.opened_at(self.confidence)
        return part, (min(low, share * lowest), max(high, highest))

    def _measure_part(self, chosen: Bools, share: float) -> tuple[float, Interval]:
        part = share * self.probability
        if share == 0.0:
            return 0.0, (0.0, self.probability)
        if self.model is not None and part > 0.0:
            return part, self._with_model(self.model, chosen, part)
        complete = self.failures.count == self.size
        if self.trials and complete:
            failed = int(chosen.sum())
            errors = min(self.errors, self.trials - failed)  # those of a pilot are among them
            return part, intervals.clopper_pearson(failed, self.trials, self.confidence, errors)
        return part, self._log_normal(chosen, part)

    def _with_model(self, model: ModelInterval, chosen: Bools, part: float) -> Interval:
        # The share is known from the failures of one model; its error adds to that of the whole.
        share, error, freedom = self.mean(chosen.astype(np.float64))
        sampling = 0.0 if chosen.all() or share <= 0.0 else t_factor(self.confidence, freedom) * error / share
        below, above = (
            math.hypot(sampling, distance) for distance in model.distances(self.probability, self.confidence)
        )
        return part * math.exp(-below), 1.0 if above >= -math.log(part) else part * math.exp(above)

    def _log_normal(self, chosen: Bools, part: float) -> Interval:
        pieces = np.bincount(self.clusters, self.shares * chosen, minlength=int(self.clusters.max()) + 1)
        if self.failures.ancestors is not None and self.runs > 1:  # runs without failures count as zero
            mean = 1.0 / self.runs
            squares = float(((pieces / pieces.sum() - mean) ** 2).sum())
            relative = (squares + (self.runs - len(pieces)) * mean**2) * self.runs / (self.runs - 1)
            freedom = self.runs - 1
        else:
            effective = float(pieces.sum() ** 2 / (pieces**2).sum())
            share = part / self.probability
            sampling = 0.0 if math.isnan(self.relative_error) else self.relative_error**2
            relative, freedom = sampling + (1.0 - share) / effective, max(1, round(effective) - 1)
        tail = self.errors / self.trials if self.trials else 0.0
        return intervals.log_normal(part, relative, self.confidence, freedom=freedom, errors=tail)


def normal_interval(value: float, error: float, confidence: float) -> Interval:
    """Return the normal interval of a value with this standard error."""
    half = normal_factor(confidence) * error
    return value - half, value + half
