"""What an estimate says of a probability, as p-values: exact where its law is known, else from its intervals.

An estimate with one-sided confidence limits at every level answers two questions about any value q: how
improbable is what was seen if the probability were q or less (``above``), or q or more (``below``)?
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from avrare.errors import UsageError
from avrare.estimation import intervals
from avrare.estimation.intervals import beta_cdf
from avrare.estimation.result import Interval, Result


class Evidence(Protocol):
    """What is kept of an estimate, in memory and in a baseline."""

    def interval_at(self, confidence: float) -> Interval:
        """The estimate's own interval."""

    def above(self, value: float) -> float:
        """p-value of "the probability is at most ``value``"; 0 to 1, increasing in it."""

    def below(self, value: float) -> float:
        """p-value of "the probability is at least ``value``"; 0 to 1, decreasing in it."""


@dataclass(frozen=True)
class Binomial:
    """Failures among a number of rollouts that was fixed beforehand (Clopper and Pearson).

    Attributes:
        failures: Rollouts that failed.
        trials: All rollouts.
        undecided: Rollouts that ended in an error: ``below`` counts them as failures.
    """

    failures: int
    trials: int
    undecided: int = 0

    def interval_at(self, confidence: float) -> Interval:
        """Clopper and Pearson's."""
        return intervals.clopper_pearson(self.failures, self.trials, confidence, self.undecided)

    def above(self, value: float) -> float:
        """P(as many failures or more | value)."""
        return beta_cdf(value, self.failures, self.trials - self.failures + 1) if self.failures else 1.0

    def below(self, value: float) -> float:
        """P(as few failures or less | value)."""
        worst = self.failures + self.undecided
        return 1.0 if worst >= self.trials else beta_cdf(1.0 - value, self.trials - worst, worst + 1)


@dataclass(frozen=True)
class InverseBinomial:
    """Rollouts up to a failure planned beforehand, the ``failures``-th; attributes as of ``Binomial``."""

    failures: int
    trials: int
    undecided: int = 0

    def interval_at(self, confidence: float) -> Interval:
        """As Monte Carlo with ``relative_error`` gives it."""
        return intervals.inverse_binomial(self.failures, self.trials, confidence, self.undecided)

    def above(self, value: float) -> float:
        """P(the failure comes as soon or sooner | value)."""
        return beta_cdf(value, self.failures, self.trials - self.failures + 1)

    def below(self, value: float) -> float:
        """P(the failure comes as late or later | value)."""
        worst = self.failures + self.undecided
        return 1.0 if worst >= self.trials else beta_cdf(1.0 - value, self.trials - worst, worst)


@dataclass(frozen=True)
class LogNormal:
    """A mean whose logarithm scatters like Student's t (docs/statistics.md).

    Attributes:
        mean: Positive.
        relative_variance: Of the mean.
        freedom: Degrees of freedom; 0: the variance is taken as known.
        undecided: Share of errors: ``below`` counts it as failures.
    """

    mean: float
    relative_variance: float
    freedom: int
    undecided: float = 0.0

    def interval_at(self, confidence: float) -> Interval:
        """As splitting and weighted samples give it."""
        return intervals.log_normal(
            self.mean, self.relative_variance, confidence, freedom=self.freedom, undecided=self.undecided
        )

    def above(self, value: float) -> float:
        """P(log mean as large or larger | value)."""
        return self._tail(self.mean, value) if value > 0.0 else 0.0

    def below(self, value: float) -> float:
        """P(log mean as small or smaller | value)."""
        return 1.0 - self._tail(self.mean, value - self.undecided) if value > self.undecided else 1.0

    def _tail(self, seen: float, value: float) -> float:
        """P(T > (log seen - log value) / width)."""
        width = math.sqrt(math.log1p(self.relative_variance))
        t = (math.log(seen) - math.log(value)) / width if width else math.copysign(math.inf, seen - value)
        if math.isinf(t) or not self.freedom:
            return 0.5 * math.erfc(t / math.sqrt(2.0))
        half = 0.5 * beta_cdf(self.freedom / (self.freedom + t * t), self.freedom / 2.0, 0.5)
        return half if t >= 0.0 else 1.0 - half


_USUAL = (0.2, 0.1, 0.05, 0.025, 0.02, 0.01, 0.005, 0.001)
_TAILS = tuple(sorted({*np.geomspace(0.999, 1e-9, 40).tolist(), *_USUAL}, reverse=True))


@dataclass(frozen=True)
class Tabulated:
    """An estimate of any other law: its intervals at many confidences.

    A p-value of more than 1/2 is given as 1, for intervals know no more; where one end says nothing (it is 0
    or 1 at any confidence) the other is taken to be one-sided.

    Attributes:
        tails: 1 - confidence, falling.
        lower: Lower ends, falling.
        upper: Upper ends, rising.
    """

    tails: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @staticmethod
    def of(interval_at: Callable[[float], Interval]) -> Tabulated:
        """From an estimate's own intervals."""
        ends = [interval_at(1.0 - tail) for tail in _TAILS]
        return Tabulated(_TAILS, tuple(low for low, _ in ends), tuple(high for _, high in ends))

    def interval_at(self, confidence: float) -> Interval:
        """The next wider interval of the table; (0, 1) beyond its end."""
        tail = (1.0 - confidence) * (1.0 + 1e-9)
        found = next((i for i, known in enumerate(self.tails) if known <= tail), None)
        return (0.0, 1.0) if found is None else (self.lower[found], self.upper[found])

    def above(self, value: float) -> float:
        """From the interval whose lower end it is."""
        one_sided = self.upper[0] >= 1.0
        return self._tail([-low for low in self.lower], -value, one_sided)

    def below(self, value: float) -> float:
        """From the interval whose upper end it is."""
        return self._tail(self.upper, value, self.lower[0] <= 0.0)

    def _tail(self, ends: Any, value: float, one_sided: bool) -> float:
        """Tail at ``value``, a step function: that of the last interval which leaves it out."""
        left_out = [tail for tail, end in zip(self.tails, ends, strict=True) if end < value]
        if not left_out:
            return 1.0
        return left_out[-1] if one_sided else 0.5 * left_out[-1]


_KINDS: dict[str, type[Any]] = {
    "binomial": Binomial, "inverse_binomial": InverseBinomial, "log_normal": LogNormal,
    "tabulated": Tabulated,
}  # fmt: skip
_LAWS: dict[Any, type[Any]] = {
    intervals.clopper_pearson: Binomial,
    intervals.inverse_binomial: InverseBinomial,
    intervals.log_normal: LogNormal,
}


def evidence_of(result: Result) -> Evidence:
    """What a result says: by the law of its intervals where it is one of the core's, else tabulated."""
    at = result.interval_at
    if isinstance(at, partial) and at.func in _LAWS:
        found: Evidence = _LAWS[at.func](*at.args, **at.keywords)
        return found
    owner = getattr(at, "__self__", None)
    if isinstance(owner, (Binomial, InverseBinomial, LogNormal, Tabulated)):
        return owner
    return Tabulated.of(at)


def to_plain(evidence: Evidence) -> dict[str, Any]:
    """The evidence as JSON-ready data."""
    kind = next(name for name, law in _KINDS.items() if isinstance(evidence, law))
    return {"law": kind, **asdict(evidence)}  # type: ignore[call-overload]


def from_plain(plain: Mapping[str, Any]) -> Evidence:
    """What ``to_plain`` gave.

    Raises:
        UsageError: It is something else.
    """
    try:
        fields = {key: tuple(v) if isinstance(v, list) else v for key, v in plain.items() if key != "law"}
        found: Evidence = _KINDS[plain["law"]](**fields)
        low, high = found.interval_at(0.95)
        told = found.above(0.5) + found.below(0.5)
        if not (0.0 <= low <= high <= 1.0 and 0.0 <= told <= 2.0):
            raise ValueError(f"its interval is {low} .. {high}")
    except (LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise UsageError(f"not an estimate: {error}") from None
    return found
