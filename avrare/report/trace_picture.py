"""Picture of a scored recording: robustness over time, and the road at the moments that matter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from avrare.record.trace_score import Score
from avrare.report.monitoring import clock, sentence
from avrare.report.picture import Frame, draw_frame, draw_road

_MOMENTS = 4
_BEHIND, _AHEAD = 40.0, 80.0
"""Stretch of road around the ego that is drawn [m]."""
_KEPT, _BROKEN, _PREFIX = "#2e7d4f", "#b0443c", "#6b7a8f"


def draw(score: Score, path: Path) -> None:
    """Draw a scored recording as a PNG; the road only where there is one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    moments = _moments(score)
    figure = Figure(figsize=(12.0, 2.6 + 1.35 * len(moments)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(1 + len(moments), 1, height_ratios=[2.0] + [1.0] * len(moments)))
    _draw_robustness(axes[0], score, moments)
    for ax, sample in zip(axes[1:], moments, strict=True):
        _draw_moment(ax, score, sample)
    if moments:
        axes[-1].set_xlabel("x [m]", fontsize=8)
    figure.suptitle(sentence(score), fontsize=10, x=0.01, ha="left")
    figure.savefig(path, dpi=110)


def _moments(score: Score) -> list[int]:
    """Samples to draw: the first violation, the worst, and others from the drive's ends to its middle."""
    if score.recording.scene is None:
        return []
    last = score.recording.samples - 1
    named = [moment.sample for moment in (score.first, score.worst) if moment is not None]
    return sorted(list(dict.fromkeys([*named, 0, last, last // 2, last // 4]))[:_MOMENTS])


def _draw_robustness(ax: Any, score: Score, moments: list[int]) -> None:
    times = score.recording.times
    if score.body is not None:
        ax.plot(times, score.body, color=_KEPT, lw=1.6, label="at each sample")
        ax.fill_between(times, score.body, 0.0, where=score.body < 0.0, color=_BROKEN, alpha=0.35, lw=0.0)
    ax.plot(times, score.prefix, color=_PREFIX, lw=1.2, ls="--", label="of the samples so far")
    ax.axhline(0.0, color="black", lw=0.8)
    for sample, (value, words) in _marks(score).items():
        at = score.recording.time(sample)
        ax.plot([at], [value], "o", color=_BROKEN if score.broken else _KEPT, ms=4.5)
        ax.annotate(words, (at, value), (5, 5), textcoords="offset points", fontsize=8)
    for sample in moments:
        ax.axvline(score.recording.time(sample), color="#9aa3ad", lw=0.6, ls=":")
    ax.set_ylabel("robustness", fontsize=8)
    ax.set_xlabel("time [s]", fontsize=8)
    ax.margins(x=0.01)
    ax.tick_params(labelsize=7)
    ax.legend(fontsize=8, frameon=False, loc="best")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _marks(score: Score) -> dict[int, tuple[float, str]]:
    """Sample -> robustness and a word for it, of the moments that can be drawn."""
    marks: dict[int, tuple[float, str]] = {}
    for moment, word in ((score.first, "first"), (score.worst, _word(score))):
        if moment is not None and np.isfinite(moment.robustness):
            before = f"{marks[moment.sample][1]}, " if moment.sample in marks else ""
            marks[moment.sample] = moment.robustness, before + word
    return marks


def _word(score: Score) -> str:
    """What the moment that decides the robustness is."""
    if not score.pointwise:
        return "decided here"
    return "worst" if score.broken else "least"


def _draw_moment(ax: Any, score: Score, sample: int) -> None:
    recording = score.recording
    assert recording.scene is not None
    words, vehicles = [], set()
    decides = "least robustness" if score.pointwise else "decides the robustness"
    for moment, name in ((score.first, "first violation"), (score.worst, decides)):
        if moment is not None and moment.sample == sample:
            words.append(name)
            vehicles |= set(moment.vehicles.values())
    world = recording.world(sample)
    draw_road(ax, recording.scene)
    draw_frame(
        ax,
        Frame(sample, world, None, None, None),
        recording.scene,
        clock(recording, sample),
        frozenset(vehicles),
    )
    ax.set_title(", ".join(words), fontsize=8, loc="left", pad=2.0)
    ego = float(world.ego.x[0])
    ax.set_xlim(ego - _BEHIND, ego + _AHEAD)
