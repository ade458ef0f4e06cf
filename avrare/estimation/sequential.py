"""Rules by which Monte Carlo may stop while it looks, and still keep its confidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from avrare.estimation import intervals
from avrare.protocols import Bools, Floats


class Stopping(Protocol):
    """When enough is seen of one specification, and what may be said then."""

    def at(self, violated: Bools, error: Bools) -> int:
        """The number of rollouts, in their order, after which it stops; 0: not within these."""

    def value(self, violated: Bools, stop: int) -> float:
        """The estimate from the first ``stop`` rollouts, or from all of them where ``stop`` is 0."""

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """The interval ``(failures, trials, confidence, undecided)`` after ``stop``, 0: without one."""


@dataclass(frozen=True)
class AtFailures:
    """Stops at a number of failures that was fixed beforehand (inverse binomial sampling, Haldane 1945).

    Attributes:
        failures: m; they leave a relative error of at most 1 / sqrt(m - 2).
    """

    failures: int

    @staticmethod
    def for_error(relative_error: float) -> AtFailures:
        """Enough failures for an estimate as exact as that."""
        return AtFailures(math.ceil(relative_error**-2) + 2)

    def at(self, violated: Bools, error: Bools) -> int:
        """Up to the last of the failures."""
        if violated.sum() < self.failures:
            return 0
        return int(np.flatnonzero(violated)[self.failures - 1]) + 1

    def value(self, violated: Bools, stop: int) -> float:
        """Unbiased: after a stop the last failure was certain and does not count."""
        return float((violated.sum() - 1) / (stop - 1) if stop else violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """Exact, with or without the stop."""
        return intervals.inverse_binomial if stop else intervals.clopper_pearson


@dataclass(frozen=True)
class AtThreshold:
    """Stops as soon as a confidence sequence tells on which side of a threshold the probability lies.

    The sequence holds at all times at once (Robbins 1970), so that one may look after every rollout: it is
    the set of p whose likelihood is not 1/(1 - confidence) times below that of a beta mixture around the
    threshold. The estimate leans away from the threshold, as one that was stopped by what it saw must; the
    interval does not mind.

    Attributes:
        threshold: In (0, 1).
        confidence: Of the decision.
    """

    threshold: float
    confidence: float

    def at(self, violated: Bools, error: Bools) -> int:
        """The first rollout after which the threshold is out; rollouts that broke down may be either."""
        count = np.arange(1, len(violated) + 1)
        pessimistic = violated | error
        below = self._out(pessimistic) & (np.cumsum(pessimistic) < self.threshold * count)
        above = self._out(violated) & (np.cumsum(violated) > self.threshold * count)
        decided = below | above
        return int(decided.argmax()) + 1 if decided.any() else 0

    def value(self, violated: Bools, stop: int) -> float:
        """Share of failures."""
        return float(violated.mean())

    def interval(self, stop: int) -> Callable[..., intervals.Interval]:
        """That of the sequence, whether it was decided or not: it has been looked at."""
        return partial(intervals.anytime, around=self.threshold)

    def _out(self, failed: Bools) -> Bools:
        return np.asarray(self._log_evidence(failed) >= -math.log(1.0 - self.confidence))

    def _log_evidence(self, failed: Bools) -> Floats:
        """(n,) log of the mixture's likelihood over that of the threshold, after each rollout."""
        a, b = intervals.mixture(self.threshold)
        before = np.arange(len(failed))
        failures: Floats = np.cumsum(failed) - failed.astype(np.float64)
        surprise = np.where(
            failed,
            np.log((a + failures) / self.threshold),
            np.log((b + before - failures) / (1.0 - self.threshold)),
        )
        return np.asarray(np.cumsum(surprise - np.log(a + b + before)))
