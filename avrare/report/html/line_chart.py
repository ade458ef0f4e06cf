"""Line charts and their axes: SVG that stretches with the page, with labels in HTML that do not."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.number_format import format_power_of_ten
from avrare.protocols import Bools, Floats
from avrare.report.html.markup import Markup, join, tag

Numbers = NDArray[Any]

_MAX_TICKS = 6


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

    def ticks(self, most: int = _MAX_TICKS) -> list[tuple[float, str]]:
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
    known = [float(value) for value in values if math.isfinite(value)] + ([0.0] if zero else [])
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        low, high = low - max(abs(low), 1.0) * 0.5, high + max(abs(high), 1.0) * 0.5
    room = margin * (high - low)
    return Scale(low - room, high + room)


def make_log_scale(values: Iterable[float], most: float = math.inf) -> Scale:
    """Return a logarithmic axis of whole decades, up to ``most``, around the positive values."""
    known = [value for value in values if 0.0 < value < math.inf]
    low = 10.0 ** math.floor(math.log10(min(known, default=1e-3)) - 1e-9)
    high = min(most, 10.0 ** math.ceil(math.log10(max(known, default=1.0)) + 1e-9))
    return Scale(low, high if high > low else 10.0 * low, log=True)


@dataclass(frozen=True)
class LineChart:
    """A chart under construction; the drawing methods add layers in order.

    Screen readers read its ``title``. A chart ``over_time`` of a rollout has a moving cursor.
    """

    x: Scale
    y: Scale
    title: str
    x_label: str = ""
    y_label: str = ""
    over_time: bool = False
    _layers: list[Markup] = field(default_factory=list)

    def draw_line(self, x: Numbers, y: Floats, style: str = "") -> None:
        """Draw a line through the finite points, with gaps at the others."""
        known = np.isfinite(y)
        pieces = np.split(np.arange(len(x)), np.flatnonzero(np.diff(known)) + 1)
        path = "".join(f"M{self._format_points(x[p], y[p])}" for p in pieces if len(p) and known[p[0]])
        self._add(path, f"line {style}")

    def draw_steps(self, x: Numbers, y: Floats, style: str = "") -> None:
        """Draw a step line: each value holds until the next."""
        self.draw_line(np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], style)

    def fill_band(self, x: Numbers, low: Floats, high: Floats, style: str = "band") -> None:
        """Fill the area between two lines."""
        self._add(f"M{self._format_points(np.r_[x, x[::-1]], np.r_[high, low[::-1]])}Z", style)

    def fill_below_zero(self, x: Numbers, y: Floats) -> None:
        """Fill the area between zero and a line below it."""
        self.fill_band(x, np.minimum(np.nan_to_num(y, neginf=self.y.low), 0.0), np.zeros(len(x)), "violated")

    def draw_bars(self, edges: Floats, heights: Floats, marked: Bools) -> None:
        """Draw a bar between each two edges, the marked ones in the colour of failures."""
        left, top, base = self.x(edges), 100.0 - self.y(heights), 100.0 - self.y.at(0.0)
        for k, height in enumerate(heights):
            if height > 0:
                width, y = max(left[k + 1] - left[k] - 0.25, 0.3), _format(min(top[k], base - 0.8))
                self._layers.append(tag(
                    "rect", class_="bar marked" if marked[k] else "bar", x=_format(left[k]),
                    width=_format(width), y=y, height=_format(base - float(y)),
                ))  # fmt: skip

    def draw_dots(self, x: Numbers, y: Floats, style: str = "") -> None:
        """Draw dots that stay round when the chart stretches: lines of length zero with round ends."""
        known = np.isfinite(x) & np.isfinite(y)
        points = (f"M{self._format_points(x[k : k + 1], y[k : k + 1])}h0" for k in np.flatnonzero(known))
        self._add("".join(points), f"dot {style}")

    def draw_zero(self, vertical: bool = False) -> None:
        """Draw the line y = 0, or x = 0, if it lies on the axis."""
        axis = self.x if vertical else self.y
        at = _format(axis.at(0.0) if vertical else 100.0 - axis.at(0.0))
        if axis.low <= 0.0 <= axis.high:
            self._add(f"M{at} 0V100" if vertical else f"M0 {at}H100", "zero")

    def draw_mark(self, x: float, style: str = "mark") -> None:
        """Draw a vertical line that marks a moment."""
        self._add(f"M{_format(self.x.at(x))} 0V100", style)

    def render(self, caption: Any = None, legend: Any = None, height: int = 168) -> Markup:
        """Return the chart as a figure; ``height`` is that of the plot [px]."""
        xs, ys = self.x.ticks(), self.y.ticks(5)
        grid = join(tag("path", class_="grid", d=f"M0 {_format(100 - self.y.at(v))}H100") for v, _ in ys)
        svg = tag(
            "svg", tag("title", self.title), grid, self._layers,
            viewBox="0 0 100 100", preserveAspectRatio="none", role="img", aria_label=self.title,
        )  # fmt: skip
        up = join(tag("span", word, style=f"top:{100 - self.y.at(v):.2f}%") for v, word in ys)
        along = join(tag("span", word, style=f"left:{self.x.at(v):.2f}%") for v, word in xs)
        area = tag("div", svg, render_cursor() if self.over_time else None, class_="area")
        return tag(
            "figure",
            tag("figcaption", caption) if caption else None,
            tag("div", self.y_label, class_="ylabel") if self.y_label else None,
            tag("div", tag("div", up, class_="ys", aria_hidden="true"), area, class_="plot",
                style=f"height:{height}px"),
            tag("div", along, class_="xs", aria_hidden="true"),
            tag("div", self.x_label, class_="xlabel") if self.x_label else None,
            tag("div", legend, class_="legend") if legend else None,
            class_="chart over-time" if self.over_time else "chart",
        )  # fmt: skip

    def _format_points(self, x: Numbers, y: Floats) -> str:
        pairs = zip(self.x(x).tolist(), (100.0 - self.y(y)).tolist(), strict=True)
        return "L".join(f"{_format(a)} {_format(b)}" for a, b in pairs)

    def _add(self, path: str, style: str) -> None:
        if path:
            self._layers.append(tag("path", class_=style.strip(), d=path))


def render_cursor() -> Markup:
    """Return the line that marks the current time."""
    return tag("div", class_="cursor", aria_hidden="true")


def render_legend(*entries: tuple[str, str]) -> Markup:
    """Return a legend of (style, word) pairs."""
    return join(tag("span", tag("i", class_=f"key {style}"), word) for style, word in entries)


def _format(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")
