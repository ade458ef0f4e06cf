"""Charts of Monte Carlo: histogram of robustness, convergence over rollouts."""

from __future__ import annotations

import numpy as np

from avrare.base.chart import Chart, Scale, make_log_scale
from avrare.base.number_format import format_percent
from avrare.estimation.result import intervals
from avrare.estimation.result.charts import draw_histogram
from avrare.estimation.result.result import Result


def draw_charts(result: Result) -> tuple[Chart, ...]:
    """Return histogram and running estimate; the latter only where robustness marks the failures."""
    return *draw_histogram(result), *_draw_convergence(result)


def _draw_convergence(result: Result) -> tuple[Chart, ...]:
    robustness, counted = result.robustness, result.diagnostics.get("used_rollouts", result.trials)
    violated = robustness < 0.0
    if result.failures.count != violated.sum():
        violated = robustness <= 0.0
    total = len(robustness)
    if total < 2 or (result.failures.count != violated.sum() and total >= counted):
        return ()
    at = np.unique(np.geomspace(1, total, 60).round().astype(int))
    failures, errors = np.cumsum(violated)[at - 1], np.cumsum(np.isnan(robustness))[at - 1]
    confidence = result.confidence
    bounds = [
        intervals.clopper_pearson(int(k), int(n), confidence, errors=int(e))
        for k, n, e in zip(failures, at, errors, strict=True)
    ]
    low, high = np.array(bounds).T
    share = failures / at
    least = min((*low[low > 0], *share[share > 0]), default=float(high[-1]) / 10.0)
    scale = make_log_scale([max(least, float(high[-1]) / 1e3), 1.0], 1.0)
    title = f"Estimate after 1 to {total} rollouts, ending at {share[-1]:.3g}"
    interval, caption = f"{format_percent(confidence)} interval of that many", "Convergence"
    if result.members:
        caption, interval = "Convergence under the scenario's own model", f"{interval}, of sampling alone"
    chart = Chart(
        Scale(1.0, float(total), log=True),
        scale,
        title,
        caption=caption,
        x_label="rollouts",
        y_label="probability",
        legend=(("line accent", "estimate"), ("box soft", interval)),
    )
    chart = chart.band(at, np.maximum(low, scale.low), high)
    return (chart.line(at, np.where(share > 0, share, np.nan), "accent"),)
