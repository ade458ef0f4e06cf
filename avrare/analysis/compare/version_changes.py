"""Change of a probability between two versions: difference and ratio, with intervals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from functools import partial

from avrare.base.number_format import format_count, format_probability, format_ratio
from avrare.base.special_functions import bisect, normal_factor
from avrare.estimation.result.intervals import Interval, clopper_pearson, divide_estimates, subtract_estimates
from avrare.estimation.result.note import list_error_notes
from avrare.estimation.result.result import Result
from avrare.protocols import Bools

_FEW_DIFFERENCES = 10
"""Rollouts with different outcomes below which no version is better, and a note asks for more."""


class VersionChange(ABC):
    """Failure probabilities of one specification under two versions.

    Attributes:
        specification: Its name.
    """

    specification: str

    @property
    @abstractmethod
    def first(self) -> float:
        """Failure probability of the first version."""

    @property
    @abstractmethod
    def second(self) -> float:
        """Failure probability of the second version."""

    @property
    @abstractmethod
    def differs(self) -> bool:
        """False where both versions have the same outcome in each rollout."""

    @property
    @abstractmethod
    def numbers(self) -> dict[str, float]:
        """Numbers of this kind of comparison alone, by name."""

    @property
    @abstractmethod
    def notes(self) -> list[str]:
        """Remarks for the reader of the numbers."""

    @abstractmethod
    def document(self) -> dict[str, object]:
        """Return the part of paired.json that this kind of comparison alone has."""

    @abstractmethod
    def exceeds(self, error_rate: float) -> bool:
        """Return whether a larger share of the rollouts ended in an error."""

    @abstractmethod
    def interval(self, confidence: float) -> Interval:
        """Return the interval of the difference."""

    @abstractmethod
    def ratio_interval(self, confidence: float) -> Interval:
        """Return the interval of the ratio; its upper end may be infinite."""

    @abstractmethod
    def highest(self, confidence: float) -> float:
        """Return the upper end of the interval of the likelier version."""

    @property
    def difference(self) -> float:
        """Failure probability of the second version minus that of the first."""
        return self.second - self.first

    @property
    def ratio(self) -> float:
        """Failure probability of the first version over that of the second; NaN where neither fails."""
        if self.second:
            return self.first / self.second
        return math.inf if self.first else math.nan

    def verdict(self, confidence: float) -> str:
        """Return "worse", "better", "same" (no outcome differs) or "not known", of the second version."""
        low, high = self.interval(confidence)
        if low > 0.0:
            return "worse"
        if high < 0.0:
            return "better"
        return "same" if (self.first or self.second) and not self.differs else "not known"

    def describe_ratio(self, confidence: float) -> str:
        """Return ``0.4 (0.2 .. 0.7)``, or ``at most 3e-4 each`` where neither version fails."""
        if math.isnan(self.difference):
            return "not known"
        if not (self.first or self.second):
            return f"at most {format_probability(self.highest(confidence), 2)} each"
        return format_ratio(self.ratio, self.ratio_interval(confidence))


@dataclass(frozen=True)
class EstimatedChange(VersionChange):
    """Estimates of both versions by an estimator, taken as independent."""

    specification: str
    results: tuple[Result, Result]
    differs = True

    @property
    def first(self) -> float:
        """Failure probability of the first version."""
        return self.results[0].probability

    @property
    def second(self) -> float:
        """Failure probability of the second version."""
        return self.results[1].probability

    @property
    def numbers(self) -> dict[str, float]:
        """Rollouts and simulated steps of both versions together."""
        return {
            "rollouts": sum(result.rollouts for result in self.results),
            "steps": sum(result.simulated_steps for result in self.results),
        }

    @property
    def notes(self) -> list[str]:
        """Health warnings of both estimates, and their first errors."""
        versions = zip(("first", "second"), self.results, strict=True)
        return [
            f"{self.specification}, {version}: {text}"
            for version, result in versions
            for text in [*result.health.values(), *list_error_notes(result.notes)]
        ]

    def document(self) -> dict[str, object]:
        """Return the entries of both results."""
        return {"estimates": [result.to_dict() for result in self.results]}

    def exceeds(self, error_rate: float) -> bool:
        """Return whether a larger share of the rollouts ended in an error."""
        return any(result.errors > error_rate * result.rollouts for result in self.results)

    def verdict(self, confidence: float) -> str:
        """Return "worse", "better" or "not known", as it is with health warnings."""
        warned = any(result.health for result in self.results)
        return "not known" if warned else super().verdict(confidence)

    def interval(self, confidence: float) -> Interval:
        """Return the interval of the difference at a confidence."""
        first, second = ((result.probability, *result.interval) for result in self.results)
        return subtract_estimates(second, first)

    def ratio_interval(self, confidence: float) -> Interval:
        """Return the interval of the ratio at a confidence."""
        first, second = ((result.probability, *result.interval) for result in self.results)
        return divide_estimates(first, second)

    def highest(self, confidence: float) -> float:
        """Return the upper end of the interval of the likelier version."""
        return max(result.interval[1] for result in self.results)


@dataclass(frozen=True)
class PairedCounts(VersionChange):
    """Rollouts by the versions under which they failed, for one specification."""

    specification: str
    both: int
    only_first: int
    only_second: int
    neither: int
    errors: int = 0  # rollouts with an error under one version or both; not in the other counts
    first_error: str = ""  # its cause

    @staticmethod
    def from_outcomes(
        specification: str, first: Bools, second: Bools, error: Bools, first_error: str
    ) -> PairedCounts:
        """Count (n,) failures under both versions."""
        first, second = first[~error], second[~error]
        return PairedCounts(
            specification,
            int((first & second).sum()),
            int((first & ~second).sum()),
            int((~first & second).sum()),
            int((~first & ~second).sum()),
            int(error.sum()),
            first_error,
        )

    @property
    def count(self) -> int:
        """Rollouts without errors."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def different(self) -> int:
        """Rollouts with different outcomes."""
        return self.only_first + self.only_second

    @property
    def first(self) -> float:
        """Failure probability of the first version."""
        return self._share(self.both + self.only_first)

    @property
    def second(self) -> float:
        """Failure probability of the second version."""
        return self._share(self.both + self.only_second)

    @property
    def difference(self) -> float:
        """Failure probability of the second version minus that of the first."""
        return self._share(self.only_second - self.only_first)

    def verdict(self, confidence: float) -> str:
        """Return "worse", "better", "same" or "not known", as it is with few different outcomes."""
        return "not known" if 0 < self.different < _FEW_DIFFERENCES else super().verdict(confidence)

    def _share(self, rollouts: int) -> float:
        return rollouts / self.count if self.count else math.nan

    def interval(self, confidence: float) -> Interval:
        """Return Tango's score interval of the difference (Statistics in Medicine 17, 1998).

        It holds whatever the outcome of rollouts with errors: they count against either end.
        """
        total, factor = self.count + self.errors, normal_factor(confidence)
        better, worse = self.only_first, self.only_second

        def end(better: int, worse: int, target: float) -> float:
            return bisect(lambda change: -_score(better, worse, total, change), target, -1.0, 1.0)

        return end(better + self.errors, worse, -factor), end(better, worse + self.errors, factor)

    @property
    def differs(self) -> bool:
        """False where both versions have the same outcome in each rollout."""
        return bool(self.different + self.errors)

    @property
    def numbers(self) -> dict[str, float]:
        """Rollouts that fail under one version only, and the p-value."""
        return {"mended": self.only_first, "newly failing": self.only_second, "p-value": self.p_value}

    @property
    def notes(self) -> list[str]:
        """Sentences on too few rollouts that differ, on none that fails, and on errors."""
        lines, total = [], self.count + self.errors
        if 0 < self.different < _FEW_DIFFERENCES:
            few = format_count(self.different, "rollout")
            lines.append(f"only {few} with different outcomes: use more rollouts")
        if not (self.both + self.different + self.errors):
            lines.append("no rollout fails: use more, or --estimators auto for rare failures")
        if self.errors:
            errors = f"{self.errors} of {total} rollouts ended in an error"
            cause = f"; the first: {self.first_error}" if self.first_error else ""
            lines.append(f"{errors}: the intervals allow for both outcomes{cause}")
        return [f"{self.specification}: {line}" for line in lines]

    def document(self) -> dict[str, object]:
        """Return the counts and the p-value."""
        return asdict(self) | {"p_value": self.p_value}

    def exceeds(self, error_rate: float) -> bool:
        """Return whether a larger share of the rollouts ended in an error."""
        return self.errors > error_rate * (self.count + self.errors)

    def highest(self, confidence: float) -> float:
        """Return the upper end of the exact interval of the likelier version."""
        most, trials = self.both + max(self.only_first, self.only_second), self.count + self.errors
        return clopper_pearson(most, trials, confidence, self.errors)[1]

    def ratio_interval(self, confidence: float) -> Interval:
        """Return the score interval of the ratio (Tang, Tang and Chan, Statistics in Medicine 22, 2003).

        It holds whatever the outcome of rollouts with errors, as that of the difference does.
        """
        factor, first, second, errors = (
            normal_factor(confidence),
            self.only_first,
            self.only_second,
            self.errors,
        )

        def end(first: int, second: int, target: float) -> float:
            score = partial(_ratio_score, self.both, first, second)
            widest = 30.0  # in logarithms
            return math.exp(bisect(lambda power: -score(math.exp(power)), target, -widest, widest))

        low = end(first, second + errors, -factor) if self.both + first else 0.0
        high = end(first + errors, second, factor) if self.both + second else math.inf
        return low, high

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the score test of no change (McNemar's), which the interval inverts.

        It is below 1 - confidence exactly where the interval excludes 0.
        """
        lead = abs(self.only_first - self.only_second) - self.errors
        return math.erfc(lead / math.sqrt(2.0 * (self.different + self.errors))) if lead > 0 else 1.0


def _score(better: int, worse: int, total: int, change: float) -> float:
    """Return Tango's statistic of "the difference is ``change``": standard normal if it is."""
    # 1. The likeliest share of ``better`` for this difference, from its quadratic equation.
    b = 2.0 * total * change - (worse + better) + (better - worse) * change
    c = -better * change * (1.0 - change)
    root = math.sqrt(max(b * b - 8.0 * total * c, 0.0))
    share = -2.0 * c / (root + b) if b > 0.0 else (root - b) / (4.0 * total)
    # 2. The distance from it in standard errors.
    distance = worse - better - total * change
    return _standardise(distance, total * (2.0 * share + change * (1.0 - change)))


def _ratio_score(both: int, first: int, second: int, ratio: float) -> float:
    """Return the statistic of "the first fails ``ratio`` times as often": standard normal if it does."""
    # 1. The likeliest share of rollouts in which the second alone fails, from its quadratic equation.
    fail = both + first + second
    b = ratio**2 * (both + second) - (both + first + 2 * second)
    c = second * (1.0 - ratio) * fail
    root = math.sqrt(max(b * b - 4.0 * (1.0 + ratio) * c, 0.0))
    alone = (root - b) / (2.0 * (1.0 + ratio)) if b < 0.0 else -2.0 * c / (root + b) if root + b else 0.0
    # 2. The distance from it in standard errors.
    distance = both + first - ratio * (both + second)
    return _standardise(distance, (1.0 + ratio) * alone + (ratio - 1.0) * fail)


def _standardise(distance: float, variance: float) -> float:
    if variance <= 0.0:
        return math.copysign(math.inf, distance) if distance else 0.0
    return distance / math.sqrt(variance)
