"""Difference and ratio of two independent estimates, from their intervals (MOVER: Zou and Donner 2008)."""

from __future__ import annotations

import math

Estimate = tuple[float, float, float]
"""Value, lower and upper end of the interval."""


def subtract_estimates(minuend: Estimate, subtrahend: Estimate) -> tuple[float, float]:
    """Return the interval of the first minus the second."""
    (value, low, high), (less, least, most) = minuend, subtrahend
    change = value - less
    return change - math.hypot(value - low, most - less), change + math.hypot(high - value, less - least)


def divide_estimates(numerator: Estimate, denominator: Estimate) -> tuple[float, float]:
    """Return the interval of the first over the second, on the logarithm; it may reach 0 and infinity."""
    (value, low, high), (divisor, least, most) = numerator, denominator
    if not (value and divisor):
        return low / most if most else 0.0, high / least if least else math.inf
    ratio = value / divisor
    below = math.hypot(_log_ratio(value, low), _log_ratio(most, divisor))
    above = math.hypot(_log_ratio(high, value), _log_ratio(divisor, least))
    return ratio * math.exp(-below), ratio * math.exp(above) if above < 700.0 else math.inf


def _log_ratio(high: float, low: float) -> float:
    return math.log(high / low) if low > 0.0 else math.inf
