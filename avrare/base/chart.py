"""Charts as values, and their axes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.number_format import format_power_of_ten

Floats = NDArray[np.float64]
Numbers = NDArray[Any]
Points = tuple[tuple[float, float], ...]
Kind = Literal["line", "area", "dots", "bars", "level", "moment"]


@dataclass(frozen=True)
class Scale:
    """Map from values, ``low`` to ``high``, to percent of an axis; both are positive if it is logarithmic."""

    low: float
    high: float
    log: bool = False

    def __call__(self, values: ArrayLike) -> Floats:
        """Return percent, clipped to the axis."""
        x = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.log:
            x = np.log(np.maximum(x, self.low))
            low, high = math.log(low), math.log(high)
        with np.errstate(over="ignore"):
            share = np.nan_to_num((x - low) / (high - low), nan=0.0)
        return np.asarray(100.0 * np.clip(share, 0.0, 1.0))

    def at(self, value: float) -> float:
        """Return percent of one value, to a hundredth."""
        return round(float(self(value)), 2)

    def ticks(self, most: int = 6) -> list[tuple[float, str]]:
        """Return round values within the axis, and their labels."""
        return self._make_log_ticks(most) if self.log else self._make_linear_ticks(most)

    def _make_log_ticks(self, most: int) -> list[tuple[float, str]]:
        first = math.ceil(math.log10(self.low) - 1e-9)
        last = math.floor(math.log10(self.high) + 1e-9)
        stride = max(1, math.ceil((last - first + 1) / most))
        return [(10.0**k, format_power_of_ten(k)) for k in range(first, last + 1) if (last - k) % stride == 0]

    def _make_linear_ticks(self, most: int) -> list[tuple[float, str]]:
        rough = (self.high - self.low) / max(most - 1, 1)
        unit = 10.0 ** math.floor(math.log10(rough))
        step = next(factor * unit for factor in (1, 2, 5, 10) if factor * unit >= rough * (1 - 1e-9))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [(k * step, f"{k * step:.10g}".replace("-", "−")) for k in range(first, last + 1)]


def make_linear_scale(values: Iterable[float], *, zero: bool = False, margin: float = 0.05) -> Scale:
    """Return a linear axis around the finite values (and 0), with margins that are a share of the range."""
    finite = [float(value) for value in values if math.isfinite(value)] + ([0.0] if zero else [])
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        low, high = low - max(abs(low), 1.0) * 0.5, high + max(abs(high), 1.0) * 0.5
    room = margin * (high - low)
    return Scale(low - room, high + room)


def make_log_scale(values: Iterable[float], most: float = math.inf) -> Scale:
    """Return a logarithmic axis of whole decades, up to ``most``, around the positive values."""
    finite = [value for value in values if 0.0 < value < math.inf]
    low = 10.0 ** math.floor(math.log10(min(finite, default=1e-3)) - 1e-9)
    high = min(most, 10.0 ** math.ceil(math.log10(max(finite, default=1.0)) + 1e-9))
    return Scale(low, high if high > low else 10.0 * low, log=True)


@dataclass(frozen=True)
class Layer:
    """Part of a chart: pieces of a line or an area, dots, bars, or a line across at a value.

    A bar is a piece of two points, its lower left and its upper right; a ``level`` is a line at the y of its
    only point, a ``moment`` one at its x.
    """

    kind: Kind
    style: str
    pieces: tuple[Points, ...]


@dataclass(frozen=True)
class Chart:
    """Chart as values: axes, layers in their order, and the words around it.

    Attributes:
        x: Horizontal axis.
        y: Vertical axis.
        title: Sentence that screen readers read.
        layers: Marks to draw, the first at the bottom.
        caption: Heading.
        x_label: Word below the horizontal axis.
        y_label: Word beside the vertical axis.
        legend: Pairs of a style and its meaning.
        note: Words after the legend.
        height: Height of the plot [px].
        over_time: Whether it is over the time of a rollout, and so has a moving cursor.
        bare: Whether the numbers of its axes say nothing.
    """

    x: Scale
    y: Scale
    title: str
    layers: tuple[Layer, ...] = ()
    caption: str = ""
    x_label: str = ""
    y_label: str = ""
    legend: tuple[tuple[str, str], ...] = ()
    note: str = ""
    height: int = 168
    over_time: bool = False
    bare: bool = False

    def line(self, x: Numbers, y: Floats, style: str = "") -> Chart:
        """Add a line through the finite points, with gaps at the others."""
        finite = np.isfinite(y)
        pieces = np.split(np.arange(len(x)), np.flatnonzero(np.diff(finite)) + 1)
        lines = [_pair(x[piece], y[piece]) for piece in pieces if len(piece) and finite[piece[0]]]
        return self._add("line", f"line {style}", lines)

    def steps(self, x: Numbers, y: Floats, style: str = "") -> Chart:
        """Add a step line: each value holds until the next."""
        return self.line(np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], style)

    def band(self, x: Numbers, low: Floats, high: Floats, style: str = "band") -> Chart:
        """Add the area between two lines."""
        return self._add("area", style, [_pair(np.r_[x, x[::-1]], np.r_[high, low[::-1]])])

    def below_zero(self, x: Numbers, y: Floats) -> Chart:
        """Add the area between zero and a line below it."""
        return self.band(
            x, np.minimum(np.nan_to_num(y, neginf=self.y.low), 0.0), np.zeros(len(x)), "violated"
        )

    def bars(self, edges: Floats, heights: Floats, style: str) -> Chart:
        """Add a bar between each two edges."""
        bars = [
            _pair(edges[k : k + 2], np.array([0.0, height])) for k, height in enumerate(heights) if height > 0
        ]
        return self._add("bars", style, bars)

    def dots(self, x: Numbers, y: Floats, style: str = "") -> Chart:
        """Add a dot at each finite point."""
        finite = np.isfinite(x) & np.isfinite(y)
        return self._add("dots", f"dot {style}", [(point,) for point in _pair(x[finite], y[finite])])

    def zero(self, vertical: bool = False) -> Chart:
        """Add the line y = 0, or x = 0, if it lies on the axis."""
        axis = self.x if vertical else self.y
        lines: list[Points] = [((0.0, 0.0),)] if axis.low <= 0.0 <= axis.high else []
        return self._add("moment" if vertical else "level", "zero", lines)

    def moment(self, x: float, style: str = "mark") -> Chart:
        """Add a vertical line that marks a moment."""
        return self._add("moment", style, [((float(x), 0.0),)])

    def _add(self, kind: Kind, style: str, pieces: Sequence[Points]) -> Chart:
        if not pieces:
            return self
        return replace(self, layers=(*self.layers, Layer(kind, style.strip(), tuple(pieces))))


def _pair(x: Numbers, y: Floats) -> Points:
    return tuple(zip(map(float, x), map(float, y), strict=True))
