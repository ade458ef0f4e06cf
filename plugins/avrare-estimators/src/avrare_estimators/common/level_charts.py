"""Charts of estimators that pass levels of a score: their scores, and the particles that pass them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from avrare.base.chart import Chart, make_linear_scale, make_log_scale
from avrare.base.errors import AvrareError
from avrare.estimation.result import charts
from avrare.estimation.result.result import Result


def draw_charts(result: Result) -> tuple[Chart, ...]:
    """Return histogram, convergence over runs, and level and surviving share of each stage."""
    if not result.diagnostics.get("levels"):
        return charts.draw_charts(result)
    histogram = charts.draw_histogram(result, "the rollouts of the first stage")
    return *histogram, *charts.draw_run_convergence(result), *_draw_levels(result)


def _draw_levels(result: Result) -> tuple[Chart, ...]:
    diagnostics, (gamma, label) = result.diagnostics, _find_gamma(result)
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


def _find_gamma(result: Result) -> tuple[Callable[[float], float], str]:
    """Return the map from levels of the score to thresholds of robustness, if it is known, and its name."""
    with suppress(AvrareError):
        origin = result.require_origin()
        return origin.estimator.prepare(origin.problem).gamma, "γ, 0 at failure"
    return float, "score"


def _list_surviving_shares(diagnostics: dict[str, object]) -> list[list[float]]:
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
