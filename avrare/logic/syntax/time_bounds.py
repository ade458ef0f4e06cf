"""Time bounds of operators: seconds to whole samples by exact rational arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

from avrare.base.errors import FormulaError
from avrare.logic.syntax.syntax_errors import make_error

_SECONDS = {"s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
_MAX_DIGITS = 400
MAX_SAMPLES = 10**14
"""Largest bound in samples: more must be a mistake and cannot index an array."""


def read_period(dt: Any) -> Fraction:
    """Convert a sampling period [s] to the rational number that its decimal text denotes: 0.1 is a tenth.

    Raises:
        FormulaError: It is not a finite number above zero.
    """
    try:
        period = dt if isinstance(dt, Fraction) else Fraction(str(dt))
    except (ValueError, ZeroDivisionError):
        period = Fraction(0)
    if period <= 0 or isinstance(dt, bool | str):
        raise FormulaError(f"dt is {dt!r}", "the sampling period must be a number of seconds above zero")
    return period


def to_sample_bounds(
    text: str, interval: Any, period: Fraction, constant: Callable[[Any], Any]
) -> tuple[int, float]:
    """Convert an interval ``[lo, hi]`` to its first and last sample.

    A bound without a unit is in seconds, except that the left one inherits the unit of the right one.

    Args:
        text: Text of the formula.
        interval: Lark tree of the interval.
        period: Sampling period [s].
        constant: Function from a name (token) to the number (token) that it stands for.

    Raises:
        FormulaError: A bound falls between samples, the first is infinite, or they are in the wrong order.
    """
    left, right = interval.children
    inherited = str(right.children[1]) if len(right.children) > 1 else "s"
    lo = _samples(text, left, inherited, period, constant)
    hi = _samples(text, right, "s", period, constant)
    if math.isinf(lo):
        raise make_error(text, left.meta, "the first bound is infinite", "only the second bound may be inf")
    if lo > hi:
        raise make_error(text, interval.meta, "the first bound is larger than the second")
    return int(lo), hi


def _samples(text: str, bound: Any, unit: str, period: Fraction, constant: Callable[[Any], Any]) -> float:
    token = bound.children[0]
    if token == "inf":
        return math.inf
    if token.type == "NAME":
        token = constant(token)
    unit = str(bound.children[1]) if len(bound.children) > 1 else unit
    if not _fits_float(token):
        raise make_error(text, bound.meta, "the bound is out of range")
    if unit.startswith("sample"):
        samples = Fraction(token)
        wrong = "the bound is not a whole number of samples"
    else:
        samples = Fraction(token) * _SECONDS[unit] / period
        wrong = f"{token} {unit} is not a whole multiple of dt = {float(period):g} s"
    if samples.denominator != 1:
        nearest = float(round(samples) * period)
        hint = f"the nearest sample is at {nearest:g} s; or give samples, as in [0:3 samples]"
        raise make_error(text, bound.meta, wrong, hint)
    if samples > MAX_SAMPLES:
        raise make_error(text, bound.meta, f"out of range: above {MAX_SAMPLES:g} samples", "write inf")
    return int(samples)


def _fits_float(token: str) -> bool:
    # Checked before conversion: the exact fraction of 1e999999999 would exhaust the memory.
    if len(token) > _MAX_DIGITS:
        return False
    value = float(token)
    mantissa = token.lower().split("e")[0]
    return math.isfinite(value) and (value != 0 or float(mantissa) == 0)
