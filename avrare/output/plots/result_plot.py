"""Plot of results: estimates with intervals and runs, and the robustness of the rollouts of a single one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.number_format import format_interval, format_probability
from avrare.base.plot import Plot
from avrare.estimation.result.result import Result
from avrare.output.plots import hide_spines, make_figure
from avrare.protocols import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LINE, _RUN, _BLIND, _FAILED = "#1b6ca8", "#9db4c8", "#d9701a", "#b0443c"


def plot_results(results: Sequence[Result]) -> Plot:
    """Draw the interval of each result on a logarithmic axis; of a single one its robustness, too."""
    shown = results[0].robustness if len(results) == 1 else np.zeros(0)
    shown = shown[np.isfinite(shown)]
    height = 1.2 + 0.45 * len(results)
    figure = make_figure(8.0, max(height, 2.6) if len(shown) else height)
    if len(shown):
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        _draw_robustness(right, results[0], shown)
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
