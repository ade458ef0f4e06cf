"""Picture of a fit's scores (matplotlib)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrare.protocols import Floats
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.student_t import student
from avrare_pem_training.cleaning import off_axis
from avrare_pem_training.scores import AXIS_NAMES, TAILS, ScoredRows, fit_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MODEL, _DATA, _SECOND = "#1b6ca8", "#d9701a", "#7b3fa0"
_BANDS = np.array([0, 10, 20, 30, 40, 50, 60, 80, 200.0])


def draw(path: Path, title: str, scored: Mapping[str, ScoredRows]) -> None:
    """Write a picture: detection above, errors below, of the labels and of the detector."""
    from matplotlib.figure import Figure

    labels, detector = scored["delivered"], scored["clean"]
    figure = Figure(figsize=(14.0, 8.4), layout="constrained")
    figure.suptitle(title, fontsize=13)
    panels = figure.subplots(2, 4)
    _reliability(panels[0, 0], labels)
    _roc(panels[0, 1], [labels, detector])
    _detection_by(panels[0, 2], detector, detector.rows.range, _BANDS, "range [m]")
    angles = np.array([0, 0.5, 1, 2, 3, 5, 10, 20, 45.0])
    _detection_by(panels[0, 3], labels, off_axis(labels.rows.yaw), angles, "angle to the ego's axes [deg]")
    for i in (0, 1):
        _quantiles(panels[1, i], detector, i)
    _tails(panels[1, 2], labels)
    _beyond(panels[1, 3], [labels, detector])
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _reliability(axes: Axes, scored: ScoredRows) -> None:
    detect, detected = scored.law.detect, scored.rows.detected
    bins = [b for b in np.array_split(np.argsort(detect, kind="stable"), 10) if len(b)]
    predicted, observed = (np.array([x[b].mean() for b in bins]) for x in (detect, detected))
    error = 2 * np.sqrt(np.maximum(observed * (1 - observed), 1e-4) / np.array([len(b) for b in bins]))
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    axes.errorbar(predicted, observed, error, fmt="o", color=_MODEL, ms=4, capsize=2)
    axes.set(xlabel="predicted probability of detection", ylabel="share detected")
    value = scored.scores["detection_calibration_error"]
    axes.set_title(f"reliability, {scored.title}: ECE {value:.3f}", fontsize=9)


def _roc(axes: Axes, several: list[ScoredRows]) -> None:
    for scored, colour in zip(several, (_MODEL, _DATA), strict=True):
        detected = scored.rows.detected[np.argsort(-scored.law.detect, kind="stable")]
        hits, alarms = (np.append(0, np.cumsum(x)) / max(1, x.sum()) for x in (detected, ~detected))
        area = scored.scores["detection_auc"]
        axes.plot(alarms, hits, color=colour, label=f"{scored.title}: {area:.3f}")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    axes.set(xlabel="share of the missed above a threshold", ylabel="share of the detected above it")
    axes.set_title("ROC of the predicted probability", fontsize=9)
    axes.legend(fontsize=8, title="area", title_fontsize=8)


def _detection_by(axes: Axes, scored: ScoredRows, x: Floats, edges: Floats, label: str) -> None:
    band = np.digitize(x, edges) - 1
    present = [i for i in range(len(edges) - 1) if (band == i).sum() >= 10]
    predicted, observed = (
        [float(values[band == i].mean()) for i in present]
        for values in (scored.law.detect, scored.rows.detected)
    )
    places = np.arange(len(present))
    axes.plot(places, predicted, "-", color=_MODEL, label="model")
    axes.plot(places, observed, "o", color=_DATA, ms=5, label="held-out rows")
    axes.set_xticks(places, [f"{edges[i]:g}-{edges[i + 1]:g}" for i in present], fontsize=7)
    axes.set(xlabel=label, ylabel="share detected", ylim=(0, 1.03))
    axes.set_title(f"detection, {scored.title}", fontsize=9)
    axes.legend(fontsize=8)


def _quantiles(axes: Axes, scored: ScoredRows, axis: int) -> None:
    detected = scored.rows.detected
    error, distance = np.abs(scored.errors[detected, axis]), scored.rows.range[detected]
    drawn = np.abs(_sample_errors(scored, axis))  # the model's mixture over the rows of a band
    band = np.digitize(distance, _BANDS) - 1
    present = [i for i in range(len(_BANDS) - 1) if (band == i).sum() >= 30]
    places = np.arange(len(present))
    quantiles = (0.5, 0.9, 0.99)
    for q, style in zip(quantiles, ("-", "--", ":"), strict=True):
        modelled, seen = ([float(np.quantile(v[band == i], q)) for i in present] for v in (drawn, error))
        axes.plot(places, modelled, style, color=_MODEL, label=f"model, {q:.0%}")
        axes.plot(places, seen, "o", color=_DATA, ms=4, label="held-out" if q == quantiles[0] else None)
    axes.set_xticks(places, [f"{_BANDS[i]:g}-{_BANDS[i + 1]:g}" for i in present], fontsize=7)
    axes.set(xlabel="range [m]", ylabel="|error| [m]", yscale="log")
    axes.set_title(f"error {AXIS_NAMES[scored.frame][axis]}, {scored.title}", fontsize=9)
    axes.legend(fontsize=8)


def _sample_errors(scored: ScoredRows, axis: int) -> Floats:
    detected = scored.rows.detected
    scale, location = scored.law.scale[detected, axis], scored.law.location[detected, axis]
    ranks = np.random.default_rng(0).standard_normal((len(scale), 20))
    power = np.ones(1) if scored.law.power is None else scored.law.power[detected, axis]
    drawn = student(scored.law.dof[axis]).draw_truncated(
        ranks, (scored.law.limit / scale)[:, None], power[:, None]
    )
    positions: Floats = location[:, None] + scale[:, None] * drawn
    return positions


def _tails(axes: Axes, scored: ScoredRows) -> None:
    sizes = np.geomspace(0.3, 40, 60)
    fits = fit_errors(scored.law, scored.rows.detected, scored.errors)
    for fit, name, colour in zip(fits, AXIS_NAMES[scored.frame], (_DATA, _SECOND), strict=True):
        seen, modelled = np.array([fit.beyond(float(size)) for size in sizes]).T
        axes.plot(sizes, modelled, "-", color=colour, lw=1, label=f"{name}, model")
        axes.plot(sizes[seen > 0], seen[seen > 0], "o", color=colour, ms=3, label=f"{name}, held-out")
    gaussian = 2 * normal.cdf(-sizes)
    axes.plot(sizes[gaussian > 1e-6], gaussian[gaussian > 1e-6], color="0.6", lw=1, label="a normal law")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="|z| = |error - location| / scale",
        ylabel="share beyond",
        ylim=(1e-5, 1.2),
    )
    axes.set_title(f"tails, {scored.title}", fontsize=9)
    axes.legend(fontsize=8)


def _beyond(axes: Axes, several: list[ScoredRows]) -> None:
    labels, seen, modelled = [], [], []
    for scored in several:
        for name in AXIS_NAMES[scored.frame]:
            labels.append(name)
            seen.append(scored.scores[f"{name}_z{TAILS[1]:g}"])
            modelled.append(scored.scores[f"{name}_z{TAILS[1]:g}_own"])
    places = np.arange(len(labels))
    axes.bar(places - 0.2, modelled, 0.38, color=_MODEL, label="the model's own")
    axes.bar(places + 0.2, seen, 0.38, color=_DATA, label="held-out")
    for place, a, b in zip(places, seen, modelled, strict=True):
        axes.annotate(f"x {a / b:.2f}" if b else "", (place, max(a, b)), ha="center", va="bottom", fontsize=8)
    axes.set_xticks(places, labels, fontsize=8)
    axes.set(ylabel="P(|z| > 4)", ylim=(0, 1.25 * max((*seen, *modelled, 1e-6))))
    axes.set_title("P(|z| > 4): labels, then detector", fontsize=9)
    axes.legend(fontsize=8)
