"""Charts of how an estimate came about: robustness, convergence, levels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from avrare.estimation import intervals
from avrare.protocols import Floats
from avrare.report.html.markup import Markup, tag
from avrare.report.html.plot import Plot, key
from avrare.report.html.scales import Scale, decades, linear

_BINS = 32
_LOOKS = 60
"""Points of a running estimate."""


def histogram(robustness: Floats, splitting: bool) -> Markup | None:
    """Robustness of the rollouts; what lies below zero broke the rule."""
    known = robustness[np.isfinite(robustness)]
    if not len(known):
        return None
    edges = _edges(known)
    counts, _ = np.histogram(known, edges)
    tallest = float(counts.max())
    plot = Plot(
        Scale(edges[0], edges[-1]), Scale(0.0, 1.08 * math.sqrt(tallest)),
        f"Histogram of the robustness of {len(known)} simulations, {int((known < 0).sum())} below zero",
        x_label="robustness",
    )  # fmt: skip
    plot.bars(edges, np.sqrt(counts), edges[1:] <= 0.0)
    plot.upright(0.0)
    of = "the first stage's simulations" if splitting else "the simulations"
    left = len(robustness) - len(known)
    beyond = f"; {left:,} without a finite value are left out" if left else ""
    legend = [key(("box", "kept"), ("box marked", "broken")), f"heights: square root of the count{beyond}"]
    return _without_ys(plot.render(f"Robustness of {of}", legend))


def convergence(entry: dict[str, Any], robustness: Floats) -> Markup | None:
    """The estimate and its interval as simulations, or runs, came in."""
    if entry["estimator"] == "mc":
        return _of_simulations(entry, robustness)
    values = np.array(entry.get("run_probabilities") or [], dtype=np.float64)
    return _of_runs(entry, values) if len(values) > 1 else None


def _of_simulations(entry: dict[str, Any], robustness: Floats) -> Markup | None:
    """Of Monte Carlo; only where the failures can be told from the robustness."""
    violated = robustness < 0.0
    if entry["failures"] != violated.sum():
        violated = robustness <= 0.0
    total = len(robustness)
    if total < 2 or (entry["failures"] != violated.sum() and total >= entry["rollouts"]):
        return None
    at = np.unique(np.geomspace(1, total, _LOOKS).round().astype(int))
    failures, errors = np.cumsum(violated)[at - 1], np.cumsum(np.isnan(robustness))[at - 1]
    confidence = entry["confidence"]
    bounds = [
        intervals.clopper_pearson(int(k), int(n), confidence, undecided=int(e))
        for k, n, e in zip(failures, at, errors, strict=True)
    ]
    low, high = np.array(bounds).T
    share = failures / at
    least = min((*low[low > 0], *share[share > 0]), default=float(high[-1]) / 10.0)
    scale = decades([max(least, float(high[-1]) / 1e3), 1.0], 1.0)
    title = f"Estimate after 1 to {total} simulations, ending at {share[-1]:.3g}"
    plot = Plot(Scale(1.0, float(total), log=True), scale, title, "simulations", "probability")
    plot.band(at, np.maximum(low, scale.low), high)
    plot.line(at, np.where(share > 0, share, np.nan), "accent")
    legend = key(("line accent", "estimate"), ("box soft", f"{100 * confidence:.4g} % interval of that many"))
    return plot.render("Convergence", legend)


def _of_runs(entry: dict[str, Any], values: Floats) -> Markup:
    """Of independent runs: each of them, their running mean and its interval."""
    many = len(values)
    at = np.arange(1, many + 1)
    mean = np.cumsum(values) / at
    bounds = [_interval_of(values[:k], entry["confidence"]) for k in at]
    low, high = np.array(bounds).T
    low[-1], high[-1] = entry["interval"]
    shown = [x for x in (*values, *mean, *entry["interval"]) if x > 0.0]  # of two runs it may span everything
    scale = decades([*shown, min(1.0, 2.0 * max(shown, default=1.0))], 1.0)
    title = f"Estimates of {many} independent runs and their running mean, ending at {mean[-1]:.3g}"
    plot = Plot(linear(at, margin=0.04), scale, title, "runs", "probability")
    known = np.isfinite(low)
    plot.band(at[known], np.maximum(low[known], scale.low), np.minimum(high[known], scale.high))
    plot.line(at, np.where(mean > 0, mean, np.nan), "accent")
    plot.dots(at, np.where(values > 0, values, scale.low), "quiet")
    legend = key(
        ("dot", "a run"), ("line accent", "mean"), ("box soft", f"{100 * entry['confidence']:.4g} % interval")
    )
    zeros = int((values == 0).sum())
    return plot.render("Convergence", [legend, f"{zeros} died out: on the lower edge" if zeros else None])


def _interval_of(values: Floats, confidence: float) -> tuple[float, float]:
    """Of some runs; NaN where they cannot tell."""
    mean = float(values.mean())
    if len(values) < 2 or mean == 0.0:
        return math.nan, math.nan
    relative = float(values.var(ddof=1)) / len(values) / mean**2
    if relative == 0.0:
        return math.nan, math.nan
    return intervals.log_normal(mean, relative, confidence, freedom=len(values) - 1)


def levels(diagnostics: dict[str, Any], gamma: Any, label: str) -> Markup | None:
    """How splitting went down: the level and the share that is left, stage by stage, a line for each run.

    Args:
        diagnostics: Of result.json.
        gamma: From a level of the score to what is drawn.
        label: What that is.
    """
    runs, shares = _numbers(diagnostics.get("levels")), _shares(diagnostics)
    if not any(map(len, runs)) or not shares:
        return None
    longest = max(map(len, runs))
    x = linear([0, longest], margin=0.02)
    thresholds = [np.array([gamma(level) for level in run], dtype=np.float64) for run in runs]
    weights = [np.r_[1.0, np.cumprod(run)] for run in shares]
    down = Plot(
        x, linear(np.concatenate(thresholds).tolist(), zero=True),
        f"Level of each of {len(runs)} runs over up to {longest} stages", "stage", label,
    )  # fmt: skip
    for run in thresholds:
        down.step(np.arange(len(run) + 1), np.r_[run, run[-1:]], "thin")
    down.level(0.0)
    left = Plot(
        x, decades([w for run in weights for w in run], 1.0),
        f"Share of the particles' weight left after each stage in {len(runs)} runs",
        "stage", "probability to come this far",
    )  # fmt: skip
    for run in weights:
        left.line(np.arange(len(run)), np.where(run > 0, run, np.nan), "thin")
    note = "each line is a run"
    return tag("div", down.render("Levels", note), left.render("Survivors", note), class_="pair")


def _shares(diagnostics: dict[str, Any]) -> list[list[float]]:
    """Share that survives each level of each run; empty where it is not known."""
    if "shares" in diagnostics:
        return _numbers(diagnostics["shares"])
    runs, rollouts = diagnostics.get("roots"), diagnostics.get("full_rollouts")
    if not isinstance(runs, list) or not runs or not isinstance(rollouts, int | float) or rollouts <= 0:
        return []
    particles = rollouts / len(runs)
    return [[1.0 - killed / particles for killed in run] for run in _numbers(diagnostics.get("discarded"))]


def _numbers(runs: Any) -> list[list[float]]:
    """What a diagnostic says of each run, stage by stage; empty where it is something else."""
    try:
        found = [np.array(run, dtype=np.float64) for run in runs]
    except (TypeError, ValueError):
        return []
    return [run.tolist() for run in found] if all(run.ndim == 1 for run in found) else []


def _edges(known: Floats) -> Floats:
    """Of the bins: zero is one of them."""
    low, high = float(known.min()), float(known.max())
    if low == high:
        low, high = low - 0.5, high + 0.5
    width = (high - low) / _BINS
    first, last = math.floor(low / width), math.ceil(high / width)
    return np.asarray(width * np.arange(first, last + 1))


def _without_ys(figure: Markup) -> Markup:
    """Heights that mean nothing but more or less need no numbers."""
    return Markup(figure.replace('<figure class="chart">', '<figure class="chart bare">', 1))
