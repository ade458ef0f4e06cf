"""Plot of a scored recording: robustness over time, and the road at the decisive moments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult, format_sample_time, summarise
from avrare.base.plot import Plot
from avrare.output.plots import hide_spines, make_figure, plain
from avrare.output.plots.rollout_plot import draw_frame, draw_road
from avrare.rollout.replay import Frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BEHIND, _AHEAD = 40.0, 80.0  # distances from the ego that are drawn [m]
_SATISFIED, _VIOLATED, _PREFIX = "#2e7d4f", "#b0443c", "#6b7a8f"


def plot_monitoring(score: MonitoringResult) -> Plot:
    """Draw a scored recording, with the road if it has one."""
    moments = _choose_samples(score)
    figure = make_figure(12.0, 2.6 + 1.35 * len(moments))
    axes = np.atleast_1d(figure.subplots(1 + len(moments), 1, height_ratios=[2.0] + [1.0] * len(moments)))
    _draw_robustness(axes[0], score, moments)
    for ax, sample in zip(axes[1:], moments, strict=True):
        _draw_moment(ax, score, sample)
    if moments:
        axes[-1].set_xlabel("x [m]", fontsize=8)
    figure.suptitle(plain(summarise(score)), fontsize=10, x=0.01, ha="left")
    return Plot(figure)


def _choose_samples(score: MonitoringResult) -> list[int]:
    # In this order: the first violation, the worst sample, the ends, the middle.
    if score.recording.scene is None:
        return []
    last = score.recording.samples - 1
    samples = [moment.sample for moment in (score.first, score.worst) if moment is not None]
    return sorted(list(dict.fromkeys([*samples, 0, last, last // 2, last // 4]))[:4])


def _draw_robustness(ax: Axes, score: MonitoringResult, moments: list[int]) -> None:
    times = score.recording.times
    if score.body is not None:
        ax.plot(times, score.body, color=_SATISFIED, lw=1.6, label="at each sample")
        ax.fill_between(times, score.body, 0.0, where=score.body < 0.0, color=_VIOLATED, alpha=0.35, lw=0.0)
    ax.plot(times, score.prefix, color=_PREFIX, lw=1.2, ls="--", label="of the samples so far")
    ax.axhline(0.0, color="black", lw=0.8)
    for sample, (value, label) in _label_decisive_samples(score).items():
        at = score.recording.time(sample)
        ax.plot([at], [value], "o", color=_VIOLATED if score.violated else _SATISFIED, ms=4.5)
        ax.annotate(label, (at, value), (5, 5), textcoords="offset points", fontsize=8)
    for sample in moments:
        ax.axvline(score.recording.time(sample), color="#9aa3ad", lw=0.6, ls=":")
    ax.set_ylabel("robustness", fontsize=8)
    ax.set_xlabel("time [s]", fontsize=8)
    ax.margins(x=0.01)
    ax.tick_params(labelsize=7)
    ax.legend(fontsize=8, frameon=False, loc="best")
    hide_spines(ax, "top", "right")


def _label_decisive_samples(score: MonitoringResult) -> dict[int, tuple[float, str]]:
    marks: dict[int, tuple[float, str]] = {}
    worst = "decided here" if not score.pointwise else "worst" if score.violated else "least"
    for moment, label in ((score.first, "first"), (score.worst, worst)):
        if moment is not None and np.isfinite(moment.robustness):
            before = f"{marks[moment.sample][1]}, " if moment.sample in marks else ""
            marks[moment.sample] = moment.robustness, before + label
    return marks


def _draw_moment(ax: Axes, score: MonitoringResult, sample: int) -> None:
    recording = score.recording
    assert recording.scene is not None
    labels, vehicles = [], set()
    decides = "least robustness" if score.pointwise else "decides the robustness"
    for moment, name in ((score.first, "first violation"), (score.worst, decides)):
        if moment is not None and moment.sample == sample:
            labels.append(name)
            vehicles |= set(moment.vehicles.values())
    world, time = recording.world(sample), format_sample_time(recording, sample)
    draw_road(ax, recording.scene)
    draw_frame(ax, Frame(sample, world), recording.scene, time, frozenset(vehicles))
    ax.set_title(", ".join(labels), fontsize=8, loc="left", pad=2.0)
    ego = float(world.ego.x[0])
    ax.set_xlim(ego - _BEHIND, ego + _AHEAD)
