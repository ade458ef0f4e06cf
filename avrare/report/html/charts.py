"""Charts of an estimate: histogram of robustness, convergence, levels of splitting."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from avrare.base.number_format import format_percent
from avrare.estimation import intervals
from avrare.estimation.result import Result
from avrare.protocols import Floats
from avrare.report.html.line_chart import LineChart, Scale, make_linear_scale, make_log_scale, render_legend
from avrare.report.html.markup import Markup, tag

_BINS = 32
_CONVERGENCE_POINTS = 60


def draw_histogram(robustness: Floats, splitting: bool) -> Markup | None:
    """Return the histogram of robustness; bars below zero are violations."""
    known = robustness[np.isfinite(robustness)]
    if not len(known):
        return None
    edges = _choose_bin_edges(known)
    counts, _ = np.histogram(known, edges)
    tallest = float(counts.max())
    chart = LineChart(
        Scale(edges[0], edges[-1]), Scale(0.0, 1.08 * math.sqrt(tallest)),
        f"Histogram of the robustness of {len(known)} rollouts, {int((known < 0).sum())} below zero",
        x_label="robustness",
    )  # fmt: skip
    chart.draw_bars(edges, np.sqrt(counts), edges[1:] <= 0.0)
    chart.draw_zero(vertical=True)
    of = "the rollouts of the first stage" if splitting else "the rollouts"
    left = len(robustness) - len(known)
    beyond = f"; {left:,} without a finite value are not shown" if left else ""
    key = [
        render_legend(("box", "satisfied"), ("box marked", "violated")),
        f"heights: square root of the count{beyond}",
    ]
    figure = chart.render(f"Robustness of {of}", key)  # heights have no unit: the numbers are hidden
    return Markup(figure.replace('<figure class="chart">', '<figure class="chart bare">', 1))


def draw_convergence(result: Result, robustness: Floats) -> Markup | None:
    """Return the running estimate and its interval over rollouts or runs; None if it is unknown.

    Over an ensemble of models the rollouts are those of the scenario's own, and there are no runs.
    """
    if result.estimator == "mc":
        return _draw_rollout_convergence(result, robustness)
    if _of_ensemble(result):
        return None
    values = result.run_probabilities
    return _draw_run_convergence(result, values) if len(values) > 1 else None


def _of_ensemble(result: Result) -> bool:
    return "model" in result.diagnostics


def _count_rollouts(result: Result) -> int:
    # Those that the estimate is made of: others chose the estimator, or came after it had stopped
    diagnostics = result.diagnostics
    counted = diagnostics.get("choice", {}).get("counting_rollouts", result.rollouts)
    return int(diagnostics.get("used_rollouts", diagnostics.get("twin", {}).get("counted", counted)))


def _draw_rollout_convergence(result: Result, robustness: Floats) -> Markup | None:
    # The failures of Monte Carlo are identified by their robustness, where that is possible.
    violated = robustness < 0.0
    if result.failures.count != violated.sum():
        violated = robustness <= 0.0
    total = len(robustness)
    if total < 2 or (result.failures.count != violated.sum() and total >= _count_rollouts(result)):
        return None
    at = np.unique(np.geomspace(1, total, _CONVERGENCE_POINTS).round().astype(int))
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
    chart = LineChart(Scale(1.0, float(total), log=True), scale, title, "rollouts", "probability")
    chart.fill_band(at, np.maximum(low, scale.low), high)
    chart.draw_line(at, np.where(share > 0, share, np.nan), "accent")
    interval = f"{format_percent(confidence)} interval of that many"
    heading = "Convergence"
    if _of_ensemble(result):
        heading, interval = "Convergence under the scenario's own model", f"{interval}, of sampling alone"
    key = render_legend(("line accent", "estimate"), ("box soft", interval))
    return chart.render(heading, key)


def _draw_run_convergence(result: Result, values: Floats) -> Markup:
    many = len(values)
    at = np.arange(1, many + 1)
    mean = np.cumsum(values) / at
    bounds = [_compute_run_interval(values[:k], result.confidence) for k in at]
    low, high = np.array(bounds).T
    low[-1], high[-1] = result.interval
    shown = [x for x in (*values, *mean, *result.interval) if x > 0.0]  # of two runs it may span everything
    scale = make_log_scale([*shown, min(1.0, 2.0 * max(shown, default=1.0))], 1.0)
    title = f"Estimates of {many} independent runs and their running mean, ending at {mean[-1]:.3g}"
    chart = LineChart(make_linear_scale(at, margin=0.04), scale, title, "runs", "probability")
    known = np.isfinite(low)
    chart.fill_band(at[known], np.maximum(low[known], scale.low), np.minimum(high[known], scale.high))
    chart.draw_line(at, np.where(mean > 0, mean, np.nan), "accent")
    chart.draw_dots(at, np.where(values > 0, values, scale.low), "quiet")
    interval = f"{format_percent(result.confidence)} interval"
    key = render_legend(("dot", "a run"), ("line accent", "mean"), ("box soft", interval))
    zeros = int((values == 0).sum())
    return chart.render("Convergence", [key, f"{zeros} died out, drawn at the lower edge" if zeros else None])


def _compute_run_interval(values: Floats, confidence: float) -> tuple[float, float]:
    mean = float(values.mean())
    defined = len(values) > 1 and mean != 0.0
    relative = float(values.var(ddof=1)) / len(values) / mean**2 if defined else 0.0
    if relative == 0.0:
        return math.nan, math.nan
    return intervals.log_normal(
        mean, relative, confidence, freedom=len(values) - 1, logs=intervals.cox(values)
    )


def draw_levels(diagnostics: dict[str, Any], gamma: Any, label: str) -> Markup | None:
    """Return level and surviving share of each stage of splitting, a line for each run; None if unknown.

    ``gamma`` maps a level of the score to the value to draw, which ``label`` names.
    """
    runs, shares = _read_stage_values(diagnostics.get("levels")), _list_surviving_shares(diagnostics)
    if not any(map(len, runs)) or not shares:
        return None
    longest = max(map(len, runs))
    x = make_linear_scale([0, longest], margin=0.02)
    thresholds = [np.array([gamma(level) for level in run], dtype=np.float64) for run in runs]
    weights = [np.r_[1.0, np.cumprod(run)] for run in shares]
    down = LineChart(
        x, make_linear_scale(np.concatenate(thresholds).tolist(), zero=True),
        f"Level of each of {len(runs)} runs over up to {longest} stages", "stage", label,
    )  # fmt: skip
    for run in thresholds:
        down.draw_steps(np.arange(len(run) + 1), np.r_[run, run[-1:]], "thin")
    down.draw_zero()
    left = LineChart(
        x, make_log_scale([w for run in weights for w in run], 1.0),
        f"Share of the particles' weight left after each stage in {len(runs)} runs",
        "stage", "probability to reach this stage",
    )  # fmt: skip
    for run in weights:
        left.draw_line(np.arange(len(run)), np.where(run > 0, run, np.nan), "thin")
    note = "each line is a run"
    return tag("div", down.render("Levels", note), left.render("Survivors", note), class_="pair")


def _list_surviving_shares(diagnostics: dict[str, Any]) -> list[list[float]]:
    if "shares" in diagnostics:
        return _read_stage_values(diagnostics["shares"])
    runs, rollouts = diagnostics.get("roots"), diagnostics.get("full_rollouts")
    if not isinstance(runs, list) or not runs or not isinstance(rollouts, int | float) or rollouts <= 0:
        return []
    particles, discarded = rollouts / len(runs), _read_stage_values(diagnostics.get("discarded"))
    return [[1.0 - killed / particles for killed in run] for run in discarded]


def _read_stage_values(runs: Any) -> list[list[float]]:
    try:
        found = [np.array(run, dtype=np.float64) for run in runs]
    except (TypeError, ValueError):
        return []
    return [run.tolist() for run in found] if all(run.ndim == 1 for run in found) else []


def _choose_bin_edges(known: Floats) -> Floats:
    low, high = float(known.min()), float(known.max())
    if low == high:
        low, high = low - 0.5, high + 0.5
    width = (high - low) / _BINS
    first, last = math.floor(low / width), math.ceil(high / width)
    return np.asarray(width * np.arange(first, last + 1))
