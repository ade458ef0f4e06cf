"""Picture of a comparison: every estimate with its interval, by estimator, on a logarithmic axis."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import Any

from avrare.compare.document import summaries
from avrare.compare.study import Comparison, Entry, Repetition
from avrare.compare.summary import Summary
from avrare.report.comparison import count, headline

_COVERS, _MISSES, _MEAN, _TRUTH = "#1b6ca8", "#d9701a", "#22303c", "#b0443c"
_BAND = 0.7
"""Share of an estimator's band that its repetitions fill."""
_WIDEST = 32
"""Letters in a line of a label."""


def draw(comparison: Comparison, path: Path) -> None:
    """Draw the comparison as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = [
        (entry, summary)
        for entry, summary in zip(comparison.entries, summaries(comparison), strict=True)
        if summary
    ]
    figure = Figure(figsize=(10.0, 1.4 + 1.15 * len(shown)), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    low, high = _range(comparison)
    truth = comparison.truth.probability if comparison.truth else None
    for place, (entry, summary) in enumerate(shown):
        _draw_estimates(ax, place, entry, truth, low)
        _draw_mean(ax, place, summary)
        _draw_speed_up(ax, place, summary)
    if truth is not None:
        ax.axvline(truth, color=_TRUTH, lw=1.2, zorder=1)
    _frame(ax, [_label(entry) for entry, _ in shown], low, high)
    figure.suptitle("\n".join(headline(comparison)), fontsize=10, x=0.01, ha="left")
    _legend(figure, ax)
    figure.savefig(path, dpi=110)


def _range(comparison: Comparison) -> tuple[float, float]:
    """Of the axis: a decade around all estimates and the truth, with room for the zeros on the left."""
    estimates = [one.probability for entry in comparison.entries for one in entry.repetitions]
    if comparison.truth:
        estimates.append(comparison.truth.probability)
    seen = [value for value in estimates if value > 0.0]
    if not seen:
        return 1e-9, 1.0
    return 10.0 ** (math.log10(min(seen)) - 1.0), min(1.0, 10.0 ** (math.log10(max(seen)) + 1.0))


def _draw_estimates(ax: Any, place: int, entry: Entry, truth: float | None, low: float) -> None:
    many = len(entry.repetitions)
    for r, one in enumerate(entry.repetitions):
        y = place + _BAND * ((r + 0.5) / many - 0.5)
        colour = _COVERS if truth is None or one.interval[0] <= truth <= one.interval[1] else _MISSES
        ax.plot(
            [max(one.interval[0], low), max(one.interval[1], low)], [y, y], color=colour, lw=1.0, alpha=0.55
        )
        _draw_dot(ax, one, y, colour, low)


def _draw_dot(ax: Any, one: Repetition, y: float, colour: str, low: float) -> None:
    at, marker = (one.probability, "o") if one.probability > 0.0 else (low, "<")
    ax.plot([at], [y], marker, color=colour, ms=4.0, mec="white", mew=0.4, clip_on=False, zorder=4)


def _draw_mean(ax: Any, place: int, summary: Summary) -> None:
    if summary.mean > 0.0:
        ends = [place - 0.5 * _BAND - 0.06, place + 0.5 * _BAND + 0.06]
        ax.plot([summary.mean] * 2, ends, color=_MEAN, lw=1.6, zorder=3)


def _label(entry: Entry) -> str:
    return "\n".join(line for word in entry.arm.words for line in textwrap.wrap(word, _WIDEST))


def _draw_speed_up(ax: Any, place: int, summary: Summary) -> None:
    accuracy = summary.accuracy
    if accuracy and accuracy.speed_up is not None:
        text, beside = f"{count(accuracy.speed_up)}x MC", ax.get_yaxis_transform()
        ax.text(1.01, place, text, transform=beside, fontsize=8, va="center")


def _frame(ax: Any, labels: list[str], low: float, high: float) -> None:
    ax.set_xscale("log")
    ax.set_xlim(low, high)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_xlabel("failure probability", fontsize=9)
    ax.tick_params(labelsize=8)
    ax.tick_params(axis="y", length=0)
    for edge in range(1, len(labels)):
        ax.axhline(edge - 0.5, color="#d5dae0", lw=0.8, zorder=0)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)


def _legend(figure: Any, ax: Any) -> None:
    from matplotlib.lines import Line2D

    keys: list[Any] = [
        Line2D([], [], color=_COVERS, marker="o", ms=4.0, lw=1.0, label="estimate, interval"),
        Line2D([], [], color=_MISSES, marker="o", ms=4.0, lw=1.0, label="interval misses the truth"),
        Line2D([], [], color=_COVERS, marker="<", ms=4.0, lw=0.0, label="estimate is zero"),
        Line2D([], [], color=_MEAN, lw=1.6, label="mean"),
        Line2D([], [], color=_TRUTH, lw=1.2, label="truth"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
