"""Charts of an estimate: histogram of robustness, convergence, levels of splitting."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from avrare.base.chart import Chart, Scale, make_linear_scale, make_log_scale
from avrare.base.number_format import format_percent
from avrare.estimation.result import intervals
from avrare.estimation.result.result import Result
from avrare.protocols import Floats

_BINS = 32
_CONVERGENCE_POINTS = 60


def draw_histogram(robustness: Floats, splitting: bool) -> Chart | None:
    """Return the histogram of robustness; bars below zero are violations."""
    finite = robustness[np.isfinite(robustness)]
    if not len(finite):
        return None
    edges = _choose_bin_edges(finite)
    counts, _ = np.histogram(finite, edges)
    tallest = float(counts.max())
    of = "the rollouts of the first stage" if splitting else "the rollouts"
    left = len(robustness) - len(finite)
    beyond = f"; {left:,} without a finite value are not shown" if left else ""
    chart = Chart(
        Scale(float(edges[0]), float(edges[-1])),
        Scale(0.0, 1.08 * math.sqrt(tallest)),
        f"Histogram of the robustness of {len(finite)} rollouts, {int((finite < 0).sum())} below zero",
        caption=f"Robustness of {of}",
        x_label="robustness",
        legend=(("box", "satisfied"), ("box marked", "violated")),
        note=f"heights: square root of the count{beyond}",
        bare=True,  # heights have no unit
    )
    heights = np.sqrt(counts)
    violated = int((edges[1:] <= 0.0).sum())
    chart = chart.bars(edges[: violated + 1], heights[:violated], "bar marked")
    return chart.bars(edges[violated:], heights[violated:], "bar").zero(vertical=True)


def draw_convergence(result: Result, robustness: Floats) -> Chart | None:
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
    return result.members > 0


def _count_rollouts(result: Result) -> int:
    # Those that the estimate is made of: others chose the estimator, or came after it had stopped
    return int(result.diagnostics.get("used_rollouts", result.trials))


def _draw_rollout_convergence(result: Result, robustness: Floats) -> Chart | None:
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
    interval, caption = f"{format_percent(confidence)} interval of that many", "Convergence"
    if _of_ensemble(result):
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
    return chart.line(at, np.where(share > 0, share, np.nan), "accent")


def _draw_run_convergence(result: Result, values: Floats) -> Chart:
    many = len(values)
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
    return chart.dots(at, np.where(values > 0, values, scale.low), "quiet")


def _compute_run_interval(values: Floats, confidence: float) -> tuple[float, float]:
    mean = float(values.mean())
    defined = len(values) > 1 and mean != 0.0
    relative = float(values.var(ddof=1)) / len(values) / mean**2 if defined else 0.0
    if relative == 0.0:
        return math.nan, math.nan
    return intervals.log_normal(
        mean, relative, confidence, freedom=len(values) - 1, logs=intervals.cox(values)
    )


def draw_levels(
    diagnostics: dict[str, Any], gamma: Callable[[float], float], label: str
) -> tuple[Chart, ...]:
    """Return charts of level and surviving share of each stage of splitting; none if they are unknown.

    ``gamma`` maps a level of the score to the value to draw, which ``label`` names.
    """
    runs, shares = _read_stage_values(diagnostics.get("levels")), _list_surviving_shares(diagnostics)
    if not any(map(len, runs)) or not shares:
        return ()
    longest = max(map(len, runs))
    x = make_linear_scale([0, longest], margin=0.02)
    thresholds = [np.array([gamma(level) for level in run], dtype=np.float64) for run in runs]
    weights = [np.r_[1.0, np.cumprod(run)] for run in shares]
    note = "each line is a run"
    down = Chart(
        x,
        make_linear_scale(np.concatenate(thresholds).tolist(), zero=True),
        f"Level of each of {len(runs)} runs over up to {longest} stages",
        caption="Levels",
        x_label="stage",
        y_label=label,
        note=note,
    )
    for run in thresholds:
        down = down.steps(np.arange(len(run) + 1), np.r_[run, run[-1:]], "thin")
    left = Chart(
        x,
        make_log_scale([w for run in weights for w in run], 1.0),
        f"Share of the particles' weight left after each stage in {len(runs)} runs",
        caption="Survivors",
        x_label="stage",
        y_label="probability to reach this stage",
        note=note,
    )
    for run in weights:
        left = left.line(np.arange(len(run)), np.where(run > 0, run, np.nan), "thin")
    return down.zero(), left


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
        stages = [np.array(run, dtype=np.float64) for run in runs]
    except (TypeError, ValueError):
        return []
    return [run.tolist() for run in stages] if all(run.ndim == 1 for run in stages) else []


def _choose_bin_edges(values: Floats) -> Floats:
    low, high = float(values.min()), float(values.max())
    if low == high:
        low, high = low - 0.5, high + 0.5
    width = (high - low) / _BINS
    first, last = math.floor(low / width), math.ceil(high / width)
    return np.asarray(width * np.arange(first, last + 1))
