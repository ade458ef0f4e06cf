"""Charts whose lines stretch with the page and whose letters do not: SVG between labels of HTML."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats
from avrare.report.html.markup import Markup, join, tag
from avrare.report.html.scales import Scale

Numbers = NDArray[Any]


@dataclass(frozen=True)
class Plot:
    """A chart under construction; the drawing methods add to it in order.

    Attributes:
        x: Horizontal axis.
        y: Vertical axis.
        title: What it shows, for those who cannot see it too.
        x_label: Name of the axis with its unit.
        y_label: Name of the axis with its unit.
        over_time: Its horizontal axis is the time of a drive: a cursor moves along it.
    """

    x: Scale
    y: Scale
    title: str
    x_label: str = ""
    y_label: str = ""
    over_time: bool = False
    _layers: list[Markup] = field(default_factory=list)

    def line(self, x: Numbers, y: Floats, style: str = "") -> None:
        """A line through finite points; it breaks at the others."""
        known = np.isfinite(y)
        pieces = np.split(np.arange(len(x)), np.flatnonzero(np.diff(known)) + 1)
        path = "".join(f"M{self._points(x[p], y[p])}" for p in pieces if len(p) and known[p[0]])
        self._add(path, f"line {style}")

    def step(self, x: Numbers, y: Floats, style: str = "") -> None:
        """A staircase: each value holds until the next."""
        self.line(np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], style)

    def band(self, x: Numbers, low: Floats, high: Floats, style: str = "band") -> None:
        """The area between two lines."""
        self._add(f"M{self._points(np.r_[x, x[::-1]], np.r_[high, low[::-1]])}Z", style)

    def below(self, x: Numbers, y: Floats, style: str = "broken") -> None:
        """The area between zero and a line where that lies below it."""
        self.band(x, np.minimum(np.nan_to_num(y, neginf=self.y.low), 0.0), np.zeros(len(x)), style)

    def bars(self, edges: Floats, heights: Floats, marked: Bools) -> None:
        """A bar between each two edges; the marked ones in the colour of failure."""
        left, top, base = self.x(edges), 100.0 - self.y(heights), 100.0 - self.y.at(0.0)
        for k, height in enumerate(heights):
            if height > 0:
                width = max(left[k + 1] - left[k] - 0.25, 0.3)
                box = {"x": _short(left[k]), "width": _short(width), "y": _short(min(top[k], base - 0.8))}
                box["height"] = _short(base - float(box["y"]))
                self._layers.append(tag("rect", class_="bar marked" if marked[k] else "bar", **box))

    def dots(self, x: Numbers, y: Floats, style: str = "") -> None:
        """Round dots, whatever the chart's proportions: lines without length, with round ends."""
        known = np.isfinite(x) & np.isfinite(y)
        points = (f"M{self._points(x[k : k + 1], y[k : k + 1])}h0" for k in np.flatnonzero(known))
        self._add("".join(points), f"dot {style}")

    def level(self, value: float, style: str = "zero") -> None:
        """A horizontal line, if it lies on the axis."""
        if self.y.low <= value <= self.y.high:
            self._add(f"M0 {_short(100.0 - self.y.at(value))}H100", style)

    def upright(self, value: float, style: str = "zero") -> None:
        """A vertical line, if it lies on the axis."""
        if self.x.low <= value <= self.x.high:
            self._add(f"M{_short(self.x.at(value))} 0V100", style)

    def render(self, caption: Any = None, legend: Any = None, height: int = 168) -> Markup:
        """The chart as a figure.

        Args:
            caption: Its heading.
            legend: What its colours mean.
            height: Of the plot [px].
        """
        xs, ys = self.x.ticks(), self.y.ticks(5)
        grid = join(tag("path", class_="grid", d=f"M0 {_short(100 - self.y.at(v))}H100") for v, _ in ys)
        svg = tag(
            "svg", tag("title", self.title), grid, self._layers,
            viewBox="0 0 100 100", preserveAspectRatio="none", role="img", aria_label=self.title,
        )  # fmt: skip
        up = join(tag("span", word, style=f"top:{100 - self.y.at(v):.2f}%") for v, word in ys)
        along = join(tag("span", word, style=f"left:{self.x.at(v):.2f}%") for v, word in xs)
        area = tag("div", svg, cursor() if self.over_time else None, class_="area")
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

    def _points(self, x: Numbers, y: Floats) -> str:
        """Where the points lie: ``12 30L13 40``."""
        pairs = zip(self.x(x).tolist(), (100.0 - self.y(y)).tolist(), strict=True)
        return "L".join(f"{_short(a)} {_short(b)}" for a, b in pairs)

    def _add(self, path: str, style: str) -> None:
        if path:
            self._layers.append(tag("path", class_=style.strip(), d=path))


def cursor() -> Markup:
    """The line that shows the moment of a drive."""
    return tag("div", class_="cursor", aria_hidden="true")


def key(*entries: tuple[str, str]) -> Markup:
    """A legend of (style, word) pairs."""
    return join(tag("span", tag("i", class_=f"key {style}"), word) for style, word in entries)


def _short(value: float) -> str:
    """Two decimals and no more zeros than needed."""
    return f"{value:.2f}".rstrip("0").rstrip(".")
