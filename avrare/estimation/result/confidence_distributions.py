"""Confidence distributions: estimates as p-values, exact for known laws, else tabulated from intervals.

An estimate with one-sided confidence limits at every level gives two p-values for any value q: of "the
probability is at most q" and of "the probability is at least q".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from types import MethodType
from typing import Any, Protocol

import numpy as np

from avrare.base.errors import UsageError
from avrare.base.special_functions import beta_cdf
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result


class ConfidenceDistribution(Protocol):
    """Confidence distribution of a failure probability, as baselines store it."""

    def interval_at(self, confidence: float) -> Interval:
        """Return the interval of the estimate."""

    def p_value_at_most(self, value: float) -> float:
        """Return the p-value of "the probability is at most ``value``"; 0 to 1, increasing."""

    def p_value_at_least(self, value: float) -> float:
        """Return the p-value of "the probability is at least ``value``"; 0 to 1, decreasing."""


@dataclass(frozen=True)
class _Counts:
    failures: int
    trials: int
    undecided: int = 0

    def p_value_at_most(self, value: float) -> float:
        # P(as many failures or more | value), or P(the last failure as early or earlier | value)
        return beta_cdf(value, self.failures, self.trials - self.failures + 1) if self.failures else 1.0


@dataclass(frozen=True)
class Binomial(_Counts):
    """Failures among a number of rollouts that was fixed beforehand (Clopper and Pearson).

    ``undecided`` rollouts ended in an error; ``p_value_at_least`` counts them as failures.
    """

    def interval_at(self, confidence: float) -> Interval:
        """Return the interval of Clopper and Pearson."""
        return intervals.clopper_pearson(self.failures, self.trials, confidence, self.undecided)

    def p_value_at_least(self, value: float) -> float:
        """Return P(as few failures or fewer | value)."""
        worst = self.failures + self.undecided
        return 1.0 if worst >= self.trials else beta_cdf(1.0 - value, self.trials - worst, worst + 1)


@dataclass(frozen=True)
class InverseBinomial(_Counts):
    """Rollouts until a number of failures that was fixed beforehand; attributes as in ``Binomial``."""

    def interval_at(self, confidence: float) -> Interval:
        """Return the interval of Monte Carlo that stopped at a relative error."""
        return intervals.inverse_binomial(self.failures, self.trials, confidence, self.undecided)

    def p_value_at_least(self, value: float) -> float:
        """Return P(the last failure comes as late or later | value)."""
        worst = self.failures + self.undecided
        return 1.0 if worst >= self.trials else beta_cdf(1.0 - value, self.trials - worst, worst)


@dataclass(frozen=True)
class LogNormal:
    """Mean whose logarithm follows Student's t (docs/statistics.md)."""

    mean: float  # > 0
    relative_variance: float  # variance of the mean over its square
    freedom: int  # degrees of freedom; 0: the variance is taken as known
    undecided: float = 0.0  # share of errors; ``p_value_at_least`` counts them as failures
    logs: tuple[float, float] | None = None  # logarithm of the mean and its variance by Cox's method

    def interval_at(self, confidence: float) -> Interval:
        """Return the interval of splitting and of weighted samples."""
        return intervals.log_normal(
            self.mean,
            self.relative_variance,
            confidence,
            freedom=self.freedom,
            errors=self.undecided,
            logs=self.logs,
        )

    def p_value_at_most(self, value: float) -> float:
        """Return P(log mean as large or larger | value)."""
        return max(self._tails(value)) if value > 0.0 else 0.0

    def p_value_at_least(self, value: float) -> float:
        """Return P(log mean as small or smaller | value)."""
        return 1.0 - min(self._tails(value - self.undecided)) if value > self.undecided else 1.0

    def _tails(self, value: float) -> list[float]:
        laws = intervals.log_normal_laws(self.mean, self.relative_variance, self.logs)
        return [self._tail(centre - math.log(value), spread) for centre, spread in laws]

    def _tail(self, gap: float, spread: float) -> float:
        # P(T > t) with t = gap / width
        t = gap / math.sqrt(spread) if spread else math.copysign(math.inf, gap)
        if math.isinf(t) or not self.freedom:
            return 0.5 * math.erfc(t / math.sqrt(2.0))
        half = 0.5 * beta_cdf(self.freedom / (self.freedom + t * t), self.freedom / 2.0, 0.5)
        return half if t >= 0.0 else 1.0 - half


_COMMON_TAILS = (0.2, 0.1, 0.05, 0.025, 0.02, 0.01, 0.005, 0.001)
_TAILS = tuple(sorted({*np.geomspace(0.999, 1e-9, 40).tolist(), *_COMMON_TAILS}, reverse=True))


@dataclass(frozen=True)
class Tabulated:
    """Estimate of any other law: its intervals at many confidences.

    A p-value above 1/2 is given as 1, since intervals do not resolve it. Where one end carries no information
    (0 or 1 at any confidence), the other is taken as one-sided.
    """

    tails: tuple[float, ...]  # 1 - confidence, decreasing
    lower: tuple[float, ...]  # lower ends, decreasing
    upper: tuple[float, ...]  # upper ends, increasing

    @staticmethod
    def from_intervals(interval_at: Callable[[float], Interval]) -> Tabulated:
        """Tabulate an estimate's own intervals."""
        ends = [interval_at(1.0 - tail) for tail in _TAILS]
        return Tabulated(_TAILS, tuple(low for low, _ in ends), tuple(high for _, high in ends))

    def interval_at(self, confidence: float) -> Interval:
        """Return the next wider interval of the table; (0, 1) beyond its end."""
        tail = (1.0 - confidence) * (1.0 + 1e-9)
        row = next((i for i, level in enumerate(self.tails) if level <= tail), None)
        return (0.0, 1.0) if row is None else (self.lower[row], self.upper[row])

    def p_value_at_most(self, value: float) -> float:
        """Return the tail of the last interval whose lower end excludes ``value``."""
        return self._tail([-low for low in self.lower], -value, self.upper[0] >= 1.0)

    def p_value_at_least(self, value: float) -> float:
        """Return the tail of the last interval whose upper end excludes ``value``."""
        return self._tail(self.upper, value, self.lower[0] <= 0.0)

    def _tail(self, ends: Iterable[float], value: float, one_sided: bool) -> float:
        excluding = [tail for tail, end in zip(self.tails, ends, strict=True) if end < value]
        return excluding[-1] * (1.0 if one_sided else 0.5) if excluding else 1.0


_LAWS: dict[str, type[Any]] = {
    "binomial": Binomial,
    "inverse_binomial": InverseBinomial,
    "log_normal": LogNormal,
    "tabulated": Tabulated,
}
_LAWS_BY_INTERVAL: dict[Any, type[Any]] = {
    intervals.clopper_pearson: Binomial,
    intervals.inverse_binomial: InverseBinomial,
    intervals.log_normal: LogNormal,
}


def derive_distribution(result: Result) -> ConfidenceDistribution:
    """Return a result's confidence distribution: exact for intervals of the core, else tabulated."""
    at = result.interval_at
    if isinstance(at, partial) and at.func in _LAWS_BY_INTERVAL:
        # Baseline files hold the name of the law's field.
        fields = {"undecided" if name == "errors" else name: value for name, value in at.keywords.items()}
        law: ConfidenceDistribution = _LAWS_BY_INTERVAL[at.func](*at.args, **fields)
        return law
    owner = at.__self__ if isinstance(at, MethodType) else None
    if isinstance(owner, (Binomial, InverseBinomial, LogNormal, Tabulated)):
        return owner
    return Tabulated.from_intervals(at)


def encode_distribution(distribution: ConfidenceDistribution) -> dict[str, object]:
    """Return a distribution as JSON-ready data."""
    name = next(name for name, law in _LAWS.items() if isinstance(distribution, law))
    assert isinstance(distribution, (Binomial, InverseBinomial, LogNormal, Tabulated))
    return {"law": name, **asdict(distribution)}


def decode_distribution(content: Mapping[str, Any]) -> ConfidenceDistribution:
    """Return the distribution that ``encode_distribution`` wrote; UsageError if it is not valid."""
    try:
        fields = {key: tuple(v) if isinstance(v, list) else v for key, v in content.items() if key != "law"}
        law: ConfidenceDistribution = _LAWS[content["law"]](**fields)
        low, high = law.interval_at(0.95)
        p_values = law.p_value_at_most(0.5) + law.p_value_at_least(0.5)
        if not (0.0 <= low <= high <= 1.0 and 0.0 <= p_values <= 2.0):
            raise ValueError(f"its interval {low} .. {high} or its p-values are not probabilities")
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise UsageError(f"not an estimate: {error}") from None
    return law
