"""Time bounds of operators, as whole samples, by exact rational arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from avrare.errors import FormulaError
from avrare.logic.complaints import complain

_SECONDS = {"s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
_MAX_DIGITS = 400
MAX_SAMPLES = 10**14
"""Samples beyond which a bound can only be a mistake, and no index of an array."""


@dataclass(frozen=True)
class Period:
    """A sampling period [s] as the rational that its decimal text says: 0.1 is a tenth."""

    seconds: Fraction

    @classmethod
    def of(cls, dt: Any) -> Period:
        """The period of a number or fraction.

        Raises:
            FormulaError: It is no finite number above zero.
        """
        try:
            seconds = dt if isinstance(dt, Fraction) else Fraction(str(dt))
        except (ValueError, ZeroDivisionError):
            seconds = Fraction(0)
        if seconds <= 0 or isinstance(dt, bool | str):
            raise FormulaError(f"dt is {dt!r}", "the sampling period is a number of seconds above zero")
        return cls(seconds)


def sample_bounds(
    text: str, interval: Any, period: Period, constant: Callable[[Any], Any]
) -> tuple[int, float]:
    """First and last sample of an interval ``[lo, hi]`` (lark tree).

    A bound without a unit is in seconds, except that the left one takes over the unit of the right one.

    Args:
        text: What the user wrote.
        interval: Where the bounds are in it.
        period: Sampling period.
        constant: The number (token) that a name (token) stands for.

    Raises:
        FormulaError: A bound falls between samples, the first is infinite, or they are in the wrong order.
    """
    left, right = interval.children
    inherited = str(right.children[1]) if len(right.children) > 1 else "s"
    lo = _samples(text, left, inherited, period, constant)
    hi = _samples(text, right, "s", period, constant)
    if math.isinf(lo):
        raise complain(text, left.meta, "the first bound is infinite", "only the second bound may be inf")
    if lo > hi:
        raise complain(text, interval.meta, "the first bound is larger than the second")
    return int(lo), hi


def _samples(text: str, bound: Any, unit: str, period: Period, constant: Callable[[Any], Any]) -> float:
    token = bound.children[0]
    if token == "inf":
        return math.inf
    if token.type == "NAME":
        token = constant(token)
    unit = str(bound.children[1]) if len(bound.children) > 1 else unit
    if not _is_sane(token):
        raise complain(text, bound.meta, "the bound is out of range")
    if unit.startswith("sample"):
        samples = Fraction(token)
        wrong = "the bound is not a whole number of samples"
    else:
        samples = Fraction(token) * _SECONDS[unit] / period.seconds
        wrong = f"{token} {unit} is not a whole multiple of dt = {float(period.seconds):g} s"
    if samples.denominator != 1:
        nearest = float(round(samples) * period.seconds)
        hint = f"the nearest sample is at {nearest:g} s; or give samples, as in [0:3 samples]"
        raise complain(text, bound.meta, wrong, hint)
    if samples > MAX_SAMPLES:
        raise complain(text, bound.meta, "the bound is out of range: no trace is so long", "write inf")
    return int(samples)


def _is_sane(token: str) -> bool:
    """Whether the number fits a float: the exact fraction of 1e999999999 would fill the memory."""
    if len(token) > _MAX_DIGITS:
        return False
    value = float(token)
    mantissa = token.lower().split("e")[0]
    return math.isfinite(value) and (value != 0 or float(mantissa) == 0)
