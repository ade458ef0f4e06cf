"""Risk balance: the rate of a rule beside that of another driver in the same scenes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from avrare.analysis.rates.combination import Quantity, Total
from avrare.base.number_format import format_probability, format_ratio
from avrare.estimation.result.intervals import divide_estimates
from avrare.estimation.result.result import Result, finite

Interval = tuple[float, float]
Terms = tuple[Total, Sequence[Result]]
"""A rule's rate, and its estimate in each scene."""


@dataclass(frozen=True)
class RiskBalance:
    """Rate at which the stack breaks a rule over that of another driver.

    Attributes:
        rule: The rule.
        unit: Unit that the rates are per.
        ratio: Of the rates; NaN where neither breaks it.
        interval: Its interval; the exposures are those of both.
        highest: Upper end of the interval of the higher rate.
        scenes: Ratio of the probabilities of each scene, with its interval.
    """

    rule: str
    unit: str
    ratio: float
    interval: Interval
    highest: float
    scenes: tuple[tuple[float, Interval], ...]

    @property
    def verdict(self) -> str:
        """Return "positive" (the stack breaks it less often), "negative" or "not known"."""
        low, high = self.interval
        return "positive" if high < 1.0 else "negative" if low > 1.0 else "not known"

    def describe(self, driver: str) -> str:
        """Return ``no_collision: 0.4 (0.2 .. 0.7) times as often as NAME: positive risk balance``."""
        if math.isnan(self.ratio):
            bound = format_probability(self.highest, 2)
            return (
                f"{self.rule}: neither the stack nor {driver} breaks it: each at most {bound} per {self.unit}"
            )
        balance = f"{self.verdict} risk balance" if self.verdict != "not known" else "risk balance not known"
        return f"{self.rule}: {format_ratio(self.ratio, self.interval)} times as often as {driver}: {balance}"

    def to_dict(self) -> dict[str, object]:
        """Return the balance as JSON-ready data; NaN and infinities become null."""
        return finite(asdict(self) | {"verdict": self.verdict})


def weigh(rule: str, unit: str, exposures: Sequence[Quantity], stack: Terms, driver: Terms) -> RiskBalance:
    """Return the balance of a rule.

    Both rates have the same exposures, which matter to the ratio only as far as the scenes have unlike
    shares of the rates.
    """
    (total, results), (reference, others) = stack, driver
    low, high = divide_estimates((total.value, *total.sampling), (reference.value, *reference.sampling))
    if total.value and reference.value:
        shifts = [
            (share - other) * max(_log(exposure.value, exposure.low), _log(exposure.high, exposure.value))
            for exposure, share, other in zip(exposures, total.shares, reference.shares, strict=True)
            if share != other
        ]
        ratio, shift = total.value / reference.value, math.hypot(*shifts)
        low = ratio * math.exp(-math.hypot(_log(ratio, low), shift))
        high = ratio * math.exp(min(math.hypot(_log(high, ratio), shift), 700.0))  # exp(710) overflows
    scenes = [
        (
            _divide(result.probability, other.probability),
            divide_estimates((result.probability, *result.interval), (other.probability, *other.interval)),
        )
        for result, other in zip(results, others, strict=True)
    ]
    highest = max(total.interval[1], reference.interval[1])
    return RiskBalance(rule, unit, _divide(total.value, reference.value), (low, high), highest, tuple(scenes))


def _log(high: float, low: float) -> float:
    return math.log(high / low) if low > 0.0 else math.inf


def _divide(value: float, divisor: float) -> float:
    return value / divisor if divisor else math.inf if value else math.nan
