"""Plots of estimates: of results with their rollouts, and of estimators that were compared."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.analysis.compare.comparison import ArmResult, Comparison
from avrare.analysis.compare.repetition_statistics import Summary
from avrare.base.number_format import format_amount, format_interval, format_probability
from avrare.base.plot import Plot
from avrare.estimation.result.result import Result
from avrare.output.plots import hide_spines, make_figure, plain
from avrare.protocols import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINE, _RUN, _BLIND, _FAILED = "#1b6ca8", "#9db4c8", "#d9701a", "#b0443c"


def plot_results(results: Sequence[Result]) -> Plot:
    """Draw the interval of each result on a logarithmic axis; of a single one its robustness, too."""
    robustness = results[0].robustness if len(results) == 1 else np.zeros(0)
    robustness = robustness[np.isfinite(robustness)]
    height = 1.2 + 0.45 * len(results)
    figure = make_figure(8.0, max(height, 2.6) if len(robustness) else height)
    if len(robustness):
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        _draw_robustness(right, results[0], robustness)
    else:
        left = figure.subplots()
    _draw_estimates(left, results)
    return Plot(figure)


def _draw_estimates(ax: Axes, results: Sequence[Result]) -> None:
    low = _least(results)
    for place, result in enumerate(results):
        begin, end = (max(limit, low) for limit in result.interval)
        ax.plot([begin, end], [place, place], color=_LINE, lw=2.5, solid_capstyle="butt", zorder=2)
        runs = result.run_probabilities[result.run_probabilities > 0.0]
        if len(result.run_probabilities) > 1:
            ax.plot(runs, np.full(len(runs), place), "|", color=_RUN, ms=11, zorder=1)
        if result.probability > 0.0:
            ax.plot(result.probability, place, "o", color=_LINE, ms=6, zorder=3)
        if result.blind_bound:
            ax.plot(max(result.blind_bound, low), place, "<", color=_BLIND, ms=6, zorder=3)
        text = f"{format_probability(result.probability)} ({format_interval(result.interval)})"
        text += f"  {', '.join(result.health)}" if result.health else ""
        ax.annotate(
            text,
            (0.0, place),
            (2, 10),
            textcoords="offset points",
            fontsize=7.5,
            xycoords=("axes fraction", "data"),
            color=_FAILED if result.health else "#333333",
        )
    ax.set_xscale("log")
    ax.set_xlim(low, 1.3)
    ax.set_ylim(len(results) - 0.4, -0.7)
    ax.set_yticks(range(len(results)), [result.specification for result in results], fontsize=8)
    several = [result for result in results if len(result.run_probabilities) > 1]
    notes = [f" | {'model' if several[0].members else 'run'}"] if several else []
    if any(result.blind_bound for result in results):
        notes.append("◂ bound of failures that the score does not lead to")
    ax.set_xlabel("probability of failure" + "".join(f"\n{note}" for note in notes), fontsize=8)
    ax.tick_params(axis="x", labelsize=8)
    hide_spines(ax, "top", "right", "left")


def _least(results: Sequence[Result]) -> float:
    # the left end of the axis: half a decade below the least number that is not 0
    positive = [x for result in results for x in (result.probability, *result.interval) if x > 0.0]
    return float(10.0 ** (np.floor(np.log10(min(positive, default=0.1)) * 2.0) / 2.0 - 0.5))


def _draw_robustness(ax: Axes, result: Result, values: Floats) -> None:
    edges = np.histogram_bin_edges(values, bins="auto" if len(values) < 5000 else 60)
    edges = np.unique(np.append(edges, 0.0)) if edges[0] < 0.0 < edges[-1] else edges  # red up to 0 exactly
    counts, _ = np.histogram(values, edges)
    colours = [_FAILED if right <= 0.0 else _RUN for right in edges[1:]]
    ax.bar(edges[:-1], counts, np.diff(edges), align="edge", color=colours)
    ax.axvline(0.0, color="#333333", lw=0.8)
    first = "first " if result.rollouts > len(result.robustness) else ""
    ax.set_xlabel(
        f"robustness of the {first}{len(values):,} rollouts\n(violated at the left of 0)", fontsize=8
    )
    ax.tick_params(labelsize=8)
    hide_spines(ax, "top", "right")


_COVERS, _MISSES, _MEAN, _TRUTH = "#1b6ca8", "#d9701a", "#22303c", "#b0443c"
_BAND = 0.7  # share of an estimator's band that its repetitions fill


def plot_comparison(comparison: Comparison) -> Plot:
    """Draw every estimate of a comparison."""
    pairs = zip(comparison.arms, comparison.summaries, strict=True)
    summaries = [(result, summary) for result, summary in pairs if summary]
    figure = make_figure(10.0, 1.4 + 1.15 * len(summaries))
    ax = figure.subplots()
    low, high = _find_range(comparison)
    truth = comparison.truth.probability if comparison.truth else None
    for place, (result, summary) in enumerate(summaries):
        _draw_arms(ax, place, result, truth, low)
        _draw_summary(ax, place, summary)
    if truth is not None:
        ax.axvline(truth, color=_TRUTH, lw=1.2, zorder=1)
    _frame(ax, [_label(result) for result, _ in summaries], low, high)
    figure.suptitle(plain("\n".join(comparison.headline())), fontsize=10, x=0.01, ha="left")
    _add_legend(figure)
    return Plot(figure)


def _find_range(comparison: Comparison) -> tuple[float, float]:
    # A decade around all estimates and the truth; zeros lie at the left end.
    estimates = [repetition.probability for result in comparison.arms for repetition in result.repetitions]
    if comparison.truth:
        estimates.append(comparison.truth.probability)
    positive = [value for value in estimates if value > 0.0]
    if not positive:
        return 1e-9, 1.0
    return 10.0 ** (math.log10(min(positive)) - 1.0), min(1.0, 10.0 ** (math.log10(max(positive)) + 1.0))


def _draw_arms(ax: Axes, place: int, result: ArmResult, truth: float | None, low: float) -> None:
    count = len(result.repetitions)
    for r, repetition in enumerate(result.repetitions):
        y = place + _BAND * ((r + 0.5) / count - 0.5)
        colour = (
            _COVERS if truth is None or repetition.interval[0] <= truth <= repetition.interval[1] else _MISSES
        )
        ax.plot([max(end, low) for end in repetition.interval], [y, y], color=colour, lw=1.0, alpha=0.55)
        at, marker = (repetition.probability, "o") if repetition.probability > 0.0 else (low, "<")
        ax.plot([at], [y], marker, color=colour, ms=4.0, mec="white", mew=0.4, clip_on=False, zorder=4)


def _draw_summary(ax: Axes, place: int, summary: Summary) -> None:
    if summary.mean > 0.0:
        ends = [place - 0.5 * _BAND - 0.06, place + 0.5 * _BAND + 0.06]
        ax.plot([summary.mean] * 2, ends, color=_MEAN, lw=1.6, zorder=3)
    if summary.accuracy and summary.accuracy.speed_up is not None:
        text, transform = f"{format_amount(summary.accuracy.speed_up)}x MC", ax.get_yaxis_transform()
        ax.text(1.01, place, text, transform=transform, fontsize=8, va="center")


def _label(result: ArmResult) -> str:
    return plain("\n".join(line for word in result.arm.label_parts for line in textwrap.wrap(word, 32)))


def _frame(ax: Axes, labels: list[str], low: float, high: float) -> None:
    ax.set_xscale("log")
    ax.set_xlim(low, high)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_xlabel("failure probability", fontsize=9)
    ax.tick_params(labelsize=8)
    ax.tick_params(axis="y", length=0)
    for edge in range(1, len(labels)):
        ax.axhline(edge - 0.5, color="#d5dae0", lw=0.8, zorder=0)
    hide_spines(ax, "top", "right", "left")


def _add_legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    keys = [
        Line2D([], [], label=label, color=colour, marker=marker, ms=4.0, lw=width)
        for label, colour, marker, width in (
            ("estimate, interval", _COVERS, "o", 1.0),
            ("interval misses the truth", _MISSES, "o", 1.0),
            ("estimate is zero", _COVERS, "<", 0.0),
            ("mean", _MEAN, None, 1.6),
            ("truth", _TRUTH, None, 1.2),
        )
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
