"""Picture of a history: every estimate with its interval over commits, on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.history.entry import Entry, breaks, series
from avrare.report.console import number

_BLUE, _FAILED, _INK, _MUTED = "#2559b8", "#b3321d", "#1b1f24", "#7a858f"
_MOST_LABELS = 16
_NARROW = 60.0
"""An axis that spans less than this factor has ticks between its decades."""


def draw(found: Sequence[Entry], path: Path) -> None:
    """Draw the entries as a PNG, a panel for each specification.

    Raises:
        OSError: It cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = list(series(found))
    figure = Figure(figsize=(10.0, 0.9 + 2.6 * len(panels)), layout="constrained")
    engine: Any = figure.get_layout_engine()
    engine.set(h_pad=0.14)
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for ax, ((scenario, specification), entries) in zip(axes, panels, strict=True):
        _panel(ax, entries)
        title = f"{scenario}  {specification}"
        ax.set_title(title, fontsize=10, loc="left", color=_INK, weight="bold", parse_math=False)
    legend = (
        "bars: intervals    red: fails its threshold    hollow: nothing failed, upper end of the interval"
    )
    figure.supxlabel(legend, fontsize=7.5, color=_MUTED, x=0.99, ha="right")
    figure.savefig(path, dpi=120)


def _panel(ax: Any, entries: Sequence[Entry]) -> None:
    low, high = _range(entries)
    for k, entry in enumerate(entries):
        colour = _FAILED if entry.verdict == "fail" else _BLUE
        ax.plot([k, k], [max(entry.low, low), entry.high], color=colour, lw=2.2, alpha=0.45)
        if entry.probability > 0.0:
            ax.plot([k], [entry.probability], "o", color=colour, ms=6.0, mec="white", mew=0.8)
        else:  # nothing failed: what is known is the upper end
            ax.plot([k], [entry.high], "v", color=colour, ms=6.0, mfc="white")
    _trend(ax, entries)
    for k, other in enumerate(breaks(entries)):
        if other:
            ax.axvline(k - 0.5, color=_MUTED, lw=1.0, ls=(0, (4, 3)))
            ax.annotate(
                "scenario or versions changed", (k - 0.5, 1.0), (4, -4), xycoords=("data", "axes fraction"),
                textcoords="offset points", fontsize=7.5, color=_MUTED, va="top",
            )  # fmt: skip
    _frame(ax, entries, low, high)


def _trend(ax: Any, entries: Sequence[Entry]) -> None:
    """Joins the estimates that answer the same question."""
    begin = 0
    for k, other in enumerate([*breaks(entries), True]):
        if other and k:
            piece = [(i, entries[i].probability or math.nan) for i in range(begin, k)]
            ax.plot(*zip(*piece, strict=True), color=_BLUE, lw=1.0, alpha=0.6, zorder=1)
            begin = k


def _frame(ax: Any, entries: Sequence[Entry], low: float, high: float) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    ax.set_yscale("log")
    ax.set_ylim(low, high)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _NARROW else (1.0,)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number(value, 1)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_xlim(-0.6, max(len(entries) - 0.4, 1.4))
    stride = math.ceil(len(entries) / _MOST_LABELS)
    ticks = range(0, len(entries), stride)
    ax.set_xticks(ticks, [f"{entries[k].commit}\n{entries[k].when:%d %b %Y}" for k in ticks])
    ax.set_ylabel("probability", fontsize=8, color=_MUTED)
    ax.tick_params(labelsize=7.5, colors=_MUTED, length=0)
    ax.grid(axis="y", color="#e3e6e8", lw=0.8)
    ax.set_axisbelow(True)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.spines["bottom"].set_color("#c9ced2")


def _range(entries: Sequence[Entry]) -> tuple[float, float]:
    """Of the axis; an interval from 0 reaches to its lower end."""
    known = [x for one in entries for x in (one.low, one.probability, one.high) if x > 0.0]
    low, high = min(known, default=1e-3), max(known, default=1.0)
    if any(one.low <= 0.0 for one in entries):
        low /= 10.0
    return low / 1.6, min(high * 2.2, 1.5)
