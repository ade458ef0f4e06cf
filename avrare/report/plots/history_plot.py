"""Plot of a history: every estimate with its interval over commits, on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.analysis.history.entry import HistoryEntry, find_breaks, group_series
from avrare.base.number_format import format_probability
from avrare.report.plots import hide_spines, make_figure, plain, save_figure

_BLUE, _FAILED, _INK, _MUTED = "#2559b8", "#b3321d", "#1b1f24", "#7a858f"
_MAX_LABELS = 16
_FEW_DECADES = 60.0  # ratio of the ends of an axis below which ticks are drawn between its decades


def draw(entries: Sequence[HistoryEntry], path: Path) -> None:
    """Draw the entries as a PNG with one panel per specification."""
    panels = list(group_series(entries))
    figure = make_figure(10.0, 0.9 + 2.6 * len(panels))
    engine: Any = figure.get_layout_engine()
    engine.set(h_pad=0.14)
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for ax, ((scenario, specification), series) in zip(axes, panels, strict=True):
        _draw_panel(ax, series)
        title = plain(f"{scenario}  {specification}")
        ax.set_title(title, fontsize=10, loc="left", color=_INK, weight="bold")
    legend = "bars: intervals    red: fails its threshold    hollow: no failures, upper end of the interval"
    figure.supxlabel(legend, fontsize=7.5, color=_MUTED, x=0.99, ha="right")
    save_figure(figure, path, dpi=120)


def _draw_panel(ax: Any, entries: Sequence[HistoryEntry]) -> None:
    low, high = _find_range(entries)
    for colour, failed in ((_BLUE, False), (_FAILED, True)):  # few artists: a history may be long
        mine = [(k, one) for k, one in enumerate(entries) if (one.verdict == "fail") == failed]
        ends = [[max(one.low, low) for _, one in mine], [one.high for _, one in mine]]
        ax.vlines([k for k, _ in mine], *ends, color=colour, lw=2.2, alpha=0.45, capstyle="projecting")
        points = [(k, one.probability) for k, one in mine if one.probability > 0.0]
        ax.plot(*_columns(points), "o", color=colour, ms=6.0, mec="white", mew=0.8)
        bounds = [(k, one.high) for k, one in mine if one.probability <= 0.0]
        ax.plot(*_columns(bounds), "v", color=colour, ms=6.0, mfc="white")  # the upper end is the result
    _join_between_breaks(ax, entries)
    for k, other in enumerate(find_breaks(entries)):
        if other:
            ax.axvline(k - 0.5, color=_MUTED, lw=1.0, ls=(0, (4, 3)))
            ax.annotate(
                "scenario or versions changed", (k - 0.5, 1.0), (4, -4), xycoords=("data", "axes fraction"),
                textcoords="offset points", fontsize=7.5, color=_MUTED, va="top",
            )  # fmt: skip
    _format_axes(ax, entries, low, high)


def _columns(points: Sequence[tuple[int, float]]) -> tuple[list[int], list[float]]:
    return [k for k, _ in points], [value for _, value in points]


def _join_between_breaks(ax: Any, entries: Sequence[HistoryEntry]) -> None:
    begin = 0
    for k, other in enumerate([*find_breaks(entries), True]):
        if other and k:
            piece = [(i, entries[i].probability or math.nan) for i in range(begin, k)]
            ax.plot(*zip(*piece, strict=True), color=_BLUE, lw=1.0, alpha=0.6, zorder=1)
            begin = k


def _format_axes(ax: Any, entries: Sequence[HistoryEntry], low: float, high: float) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    ax.set_yscale("log")
    ax.set_ylim(low, high)
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _FEW_DECADES else (1.0,)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_probability(value, 1)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_xlim(-0.6, max(len(entries) - 0.4, 1.4))
    stride = math.ceil(len(entries) / _MAX_LABELS)
    ticks = range(0, len(entries), stride)
    ax.set_xticks(ticks, [plain(f"{entries[k].commit}\n{entries[k].when:%d %b %Y}") for k in ticks])
    ax.set_ylabel("probability", fontsize=8, color=_MUTED)
    ax.tick_params(labelsize=7.5, colors=_MUTED, length=0)
    ax.grid(axis="y", color="#e3e6e8", lw=0.8)
    ax.set_axisbelow(True)
    hide_spines(ax, "top", "right", "left")
    ax.spines["bottom"].set_color("#c9ced2")


def _find_range(entries: Sequence[HistoryEntry]) -> tuple[float, float]:
    known = [x for one in entries for x in (one.low, one.probability, one.high) if x > 0.0]
    low, high = min(known, default=1e-3), max(known, default=1.0)
    if any(one.low <= 0.0 for one in entries):  # an interval from 0 reaches down to the lower end
        low /= 10.0
    return low / 1.6, min(high * 2.2, 1.5)
