"""Stopping rules of Monte Carlo that keep the confidence of its interval."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from avrare.estimation.result import intervals
from avrare.protocols import Bools, Floats


@dataclass(frozen=True)
class AtFailures:
    """Stop at a number m of failures fixed beforehand (inverse binomial sampling, Haldane 1945).

    The relative error is then at most 1 / sqrt(m - 2).
    """

    failures: int

    @staticmethod
    def for_error(relative_error: float) -> AtFailures:
        """Return the rule with enough failures for this relative error."""
        return AtFailures(math.ceil(relative_error**-2) + 2)

    def at(self, violated: Bools, error: Bools) -> int:
        """Return the number of rollouts after which the rule stops, 0 if it does not stop within these."""
        if violated.sum() < self.failures:
            return 0
        return int(np.flatnonzero(violated)[self.failures - 1]) + 1

    def value(self, violated: Bools, stop: int) -> float:
        """Return the unbiased estimate: after a stop the last failure was certain and does not count."""
        return float((violated.sum() - 1) / (stop - 1) if stop else violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """Return the exact interval ``(failures, trials, confidence, errors)``, with or without a stop."""
        return intervals.inverse_binomial if stop else intervals.clopper_pearson


@dataclass(frozen=True)
class AtThreshold:
    """Stop as soon as a confidence sequence excludes a threshold.

    The sequence is valid at all times at once (Robbins 1970), so it may be evaluated after every rollout:
    it is the set of p whose likelihood is not 1/(1 - confidence) times below that of a beta mixture around
    the threshold. Stopping biases the estimate away from the threshold; the interval remains valid.
    """

    threshold: float
    confidence: float  # of the decision

    def at(self, violated: Bools, error: Bools) -> int:
        """Return the first rollout after which the threshold is excluded, whatever the errors are, or 0."""
        count = np.arange(1, len(violated) + 1)
        pessimistic = violated | error
        below = self._out(pessimistic) & (np.cumsum(pessimistic) < self.threshold * count)
        above = self._out(violated) & (np.cumsum(violated) > self.threshold * count)
        decided = below | above
        return int(decided.argmax()) + 1 if decided.any() else 0

    def value(self, violated: Bools, stop: int) -> float:
        """Return the share of failures."""
        return float(violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """Return the interval of the sequence, whether it has stopped or not."""
        return partial(intervals.anytime, around=self.threshold)

    def _out(self, failed: Bools) -> Bools:
        return np.asarray(self._log_evidence(failed) >= -math.log(1.0 - self.confidence))

    def _log_evidence(self, failed: Bools) -> Floats:
        # log likelihood ratio of mixture and threshold after each rollout, (n,)
        a, b = intervals.mixture(self.threshold)
        before = np.arange(len(failed))
        failures: Floats = np.cumsum(failed) - failed.astype(np.float64)
        surprise = np.where(
            failed,
            np.log((a + failures) / self.threshold),
            np.log((b + before - failures) / (1.0 - self.threshold)),
        )
        return np.asarray(np.cumsum(surprise - np.log(a + b + before)))


Stopping = AtFailures | AtThreshold
"""Stopping rule of one specification, with its estimate and interval."""
