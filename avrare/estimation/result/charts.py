"""Charts of an estimate, for estimators to declare: histogram of robustness, convergence over runs."""

from __future__ import annotations

import math

import numpy as np

from avrare.base.chart import Chart, Scale, make_linear_scale, make_log_scale
from avrare.base.number_format import format_percent
from avrare.estimation.result import intervals
from avrare.estimation.result.result import Result
from avrare.protocols import Floats


def draw_charts(result: Result) -> tuple[Chart, ...]:
    """Return the charts of estimators that declare no charts."""
    return *draw_histogram(result), *draw_run_convergence(result)


def draw_histogram(result: Result, rollouts: str = "") -> tuple[Chart, ...]:
    """Return the histogram of robustness; bars below zero are violations. ``rollouts`` names the rollouts."""
    robustness = result.robustness
    if not rollouts:
        stored, total = len(robustness), result.rollouts
        rollouts = "the rollouts" if stored >= total else f"{stored:,} of {total:,} rollouts"
    finite = robustness[np.isfinite(robustness)]
    if not len(finite):
        return ()
    edges = _choose_bin_edges(finite)
    counts, _ = np.histogram(finite, edges)
    tallest = float(counts.max())
    left = len(robustness) - len(finite)
    beyond = f"; {left:,} without a finite value are not shown" if left else ""
    chart = Chart(
        Scale(float(edges[0]), float(edges[-1])),
        Scale(0.0, 1.08 * math.sqrt(tallest)),
        f"Histogram of the robustness of {len(finite)} rollouts, {int((finite < 0).sum())} below zero",
        caption=f"Robustness of {rollouts}",
        x_label="robustness",
        legend=(("box", "satisfied"), ("box marked", "violated")),
        note=f"heights: square root of the count{beyond}",
        bare=True,  # heights have no unit
    )
    heights = np.sqrt(counts)
    violated = int((edges[1:] <= 0.0).sum())
    chart = chart.bars(edges[: violated + 1], heights[:violated], "bar marked")
    return (chart.bars(edges[violated:], heights[violated:], "bar").zero(vertical=True),)


def draw_run_convergence(result: Result) -> tuple[Chart, ...]:
    """Return the estimates of several runs with their running mean and interval; none over an ensemble."""
    values, many = result.run_probabilities, len(result.run_probabilities)
    if many < 2 or result.members:
        return ()
    at = np.arange(1, many + 1)
    mean = np.cumsum(values) / at
    bounds = [_compute_run_interval(values[:k], result.confidence) for k in at]
    low, high = np.array(bounds).T
    low[-1], high[-1] = result.interval
    # the interval of two runs may span everything
    positive = [x for x in (*values, *mean, *result.interval) if x > 0.0]
    scale = make_log_scale([*positive, min(1.0, 2.0 * max(positive, default=1.0))], 1.0)
    title = f"Estimates of {many} independent runs and their running mean, ending at {mean[-1]:.3g}"
    zeros, defined = int((values == 0).sum()), np.isfinite(low)
    interval = f"{format_percent(result.confidence)} interval"
    chart = Chart(
        make_linear_scale(at, margin=0.04),
        scale,
        title,
        caption="Convergence",
        x_label="runs",
        y_label="probability",
        legend=(("dot", "a run"), ("line accent", "mean"), ("box soft", interval)),
        note=f"{zeros} died out, drawn at the lower edge" if zeros else "",
    )
    chart = chart.band(
        at[defined], np.maximum(low[defined], scale.low), np.minimum(high[defined], scale.high)
    )
    chart = chart.line(at, np.where(mean > 0, mean, np.nan), "accent")
    return (chart.dots(at, np.where(values > 0, values, scale.low), "quiet"),)


def _compute_run_interval(values: Floats, confidence: float) -> tuple[float, float]:
    mean = float(values.mean())
    defined = len(values) > 1 and mean != 0.0
    relative = float(values.var(ddof=1)) / len(values) / mean**2 if defined else 0.0
    if relative == 0.0:
        return math.nan, math.nan
    return intervals.log_normal(
        mean, relative, confidence, freedom=len(values) - 1, logs=intervals.cox(values)
    )


def _choose_bin_edges(values: Floats) -> Floats:
    low, high = float(values.min()), float(values.max())
    if low == high:
        low, high = low - 0.5, high + 0.5
    width = (high - low) / 32
    first, last = math.floor(low / width), math.ceil(high / width)
    return np.asarray(width * np.arange(first, last + 1))
