"""Axes: where a value lies, in percent, and where the ticks are."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from avrare.protocols import Floats

_MOST_TICKS = 6


@dataclass(frozen=True)
class Scale:
    """From values to percent of an axis.

    Attributes:
        low: Value at 0 %.
        high: Value at 100 %.
        log: Logarithmic; both ends are positive.
    """

    low: float
    high: float
    log: bool = False

    def __call__(self, values: ArrayLike) -> Floats:
        """Percent, clipped to the axis."""
        x = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.log:
            x = np.log(np.maximum(x, self.low))
            low, high = math.log(low), math.log(high)
        with np.errstate(over="ignore"):
            share = np.nan_to_num((x - low) / (high - low), nan=0.0)
        return np.asarray(100.0 * np.clip(share, 0.0, 1.0))

    def at(self, value: float) -> float:
        """Percent of one value, to a hundredth."""
        return round(float(self(value)), 2)

    def ticks(self, most: int = _MOST_TICKS) -> list[tuple[float, str]]:
        """Round values within the axis, and their labels."""
        return self._decades(most) if self.log else self._steps(most)

    def _decades(self, most: int) -> list[tuple[float, str]]:
        first = math.ceil(math.log10(self.low) - 1e-9)
        last = math.floor(math.log10(self.high) + 1e-9)
        stride = max(1, math.ceil((last - first + 1) / most))
        return [(10.0**k, power(k)) for k in range(first, last + 1) if (last - k) % stride == 0]

    def _steps(self, most: int) -> list[tuple[float, str]]:
        rough = (self.high - self.low) / max(most - 1, 1)
        unit = 10.0 ** math.floor(math.log10(rough))
        step = next(factor * unit for factor in (1, 2, 5, 10) if factor * unit >= rough * (1 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [(k * step, f"{k * step:.10g}".replace("-", "−")) for k in range(first, last + 1)]


def linear(values: Iterable[float], *, zero: bool = False, margin: float = 0.05) -> Scale:
    """An axis around the finite ones among some values.

    Args:
        values: What it has to show.
        zero: 0 is among them.
        margin: Room at both ends, as a share of the range.
    """
    known = [float(value) for value in values if math.isfinite(value)] + ([0.0] if zero else [])
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        low, high = low - max(abs(low), 1.0) * 0.5, high + max(abs(high), 1.0) * 0.5
    room = margin * (high - low)
    return Scale(low - room, high + room)


def decades(values: Iterable[float], most: float = math.inf) -> Scale:
    """A logarithmic axis of whole decades around the positive ones among some values.

    Args:
        values: What it has to show.
        most: Upper end that is not passed.
    """
    known = [value for value in values if 0.0 < value < math.inf]
    low = 10.0 ** math.floor(math.log10(min(known, default=1e-3)) - 1e-9)
    high = min(most, 10.0 ** math.ceil(math.log10(max(known, default=1.0)) + 1e-9))
    return Scale(low, high if high > low else 10.0 * low, log=True)


def power(exponent: int) -> str:
    """``10⁻³``; 1 and 0.1 as they are."""
    if exponent in (0, -1):
        return "1" if exponent == 0 else "0.1"
    digits = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"10{digits}"
