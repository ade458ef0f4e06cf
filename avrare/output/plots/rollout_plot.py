"""Plots of a rollout: the road with all that is seen at a few moments, and its signals over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.number_format import format_robustness
from avrare.base.plot import Plot
from avrare.driving import Scene, Vehicles
from avrare.driving.geometry import Rectangle
from avrare.driving.lanes import list_lanes, list_markings
from avrare.estimation.result.result import Result
from avrare.output.plots import hide_spines, make_figure, plain
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import Frame, Trace, make_frames, replay_tapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOMENTS = 6
_WIDTH, _MIN_ROW_HEIGHT = 12.0, 1.05  # of the plot, of a moment [inches]
_BEHIND, _AHEAD = 70.0, 150.0  # distances from the ego that are drawn then [m]
_EGO, _OTHER, _PARKED, _MARKED = "#1b6ca8", "#6b7a8f", "#b0443c", "#d9701a"
_SEEN, _ESTIMATE, _PLAN = "#e08a1e", "#7b3fa0", "#1b6ca8"


def draw_run(scenario: LoadedScenario, results: Sequence[Result], folder: Path) -> list[Path]:
    """Draw the noise-free rollout and the worst rollout of each result into ``folder``."""
    problem = scenario.problem(scenario.specifications)
    quiet = np.zeros((problem.steps + 1, problem.noise_size))
    tapes = [("nominal", "noise-free rollout", quiet)]
    for result in results:
        if not np.isnan(result.worst.robustness):
            least = f"robustness {format_robustness(result.worst.robustness)}"
            title = f"{result.specification}: worst of {result.rollouts} rollouts, {least}"
            tapes.append((f"worst_{result.specification}", title, result.worst.noise))
    rollouts = replay_tapes(problem, np.stack([tape for _, _, tape in tapes]))
    paths = [folder / f"{name}.png" for name, _, _ in tapes]
    loop = scenario.stack.loop
    scene = loop.scene or loop.simulator.junction
    assert scene is not None
    for path, (_, title, _), rollout in zip(paths, tapes, rollouts, strict=True):
        plot_drive(make_frames(loop, rollout), scene, f"{scenario.name}: {title}").save(path)
    return paths


def plot_drive(frames: Sequence[Frame], scene: Scene, title: str) -> Plot:
    """Draw a few moments of a rollout below one another, or side by side without lanes."""
    if not scene.road.lane_centres:
        return _plot_plane(frames, scene, title)
    chosen = _choose_moments(frames)
    figure = make_figure(_WIDTH, _MIN_ROW_HEIGHT * len(chosen) + 0.9)
    follow = scene.road.end - scene.road.begin > 300.0  # on a longer road [m] cars would be specks
    axes = np.atleast_1d(figure.subplots(len(chosen), 1, sharex=not follow, sharey=True))
    for ax, frame in zip(axes, chosen, strict=True):
        draw_road(ax, scene)
        if follow:
            x = float(frame.world.ego.x[0])
            ax.set_xlim(x - _BEHIND, x + _AHEAD)
        draw_frame(ax, frame, scene)
    for ax, frame in zip(axes, chosen, strict=True):  # after all roads: each resets the shared y limits
        _widen_limits(ax, frame)
    (left, right), (low, high) = axes[-1].get_xlim(), axes[-1].get_ylim()
    row = (high - low) / (right - left) * _WIDTH + (0.35 if follow else 0.15)
    figure.set_figheight(max(row, _MIN_ROW_HEIGHT) * len(chosen) + 0.9)
    axes[-1].set_xlabel("x [m]")
    figure.suptitle(plain(title), fontsize=11, x=0.01, ha="left")
    handles, labels = axes[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    return Plot(figure)


def _choose_moments(frames: Sequence[Frame]) -> list[Frame]:
    return [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _MOMENTS).round().astype(int))]


def _plot_plane(frames: Sequence[Frame], scene: Scene, title: str) -> Plot:
    chosen = _choose_moments(frames[: _find_end(frames) + 1])
    figure = make_figure(_WIDTH, 0.67 * _WIDTH)
    places = np.array([[frame.world.ego.x[0], frame.world.ego.y[0]] for frame in frames])
    low, high = places.min(axis=0), places.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.5 * float((high - low).max()) + 15.0  # [m]
    axes = figure.subplots(2, _MOMENTS // 2, sharex=True, sharey=True, squeeze=False).ravel()
    for ax in axes[len(chosen) :]:
        ax.set_axis_off()
    for ax, frame in zip(axes, chosen, strict=False):
        _draw_paths(ax, scene)
        draw_frame(ax, frame, scene)
        ax.set_xlim(middle[0] - reach, middle[0] + reach)
        ax.set_ylim(middle[1] - reach, middle[1] + reach)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.suptitle(plain(title), fontsize=11, x=0.01, ha="left")
    figure.legend(handles, labels, loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    return Plot(figure)


def _find_end(frames: Sequence[Frame]) -> int:
    """Return the first of the last frames that show the same."""
    last = frames[-1].world
    for index in range(len(frames) - 1, 0, -1):
        world = frames[index - 1].world
        if not (np.array_equal(world.ego.x, last.ego.x) and np.array_equal(world.others.x, last.others.x)):
            return index
    return 0


def _draw_paths(ax: Axes, scene: Scene) -> None:
    for path in scene.road.paths:
        slope = np.gradient(path, axis=0)
        aside = 0.5 * scene.road.lane_width * slope[:, ::-1] * (-1.0, 1.0)
        aside /= np.hypot(*slope.T)[:, None]
        ax.fill(*np.concatenate([path + aside, (path - aside)[::-1]]).T, color="#e8ebee", lw=0, zorder=0)
    ax.set_aspect("equal")
    ax.tick_params(labelsize=7)
    hide_spines(ax, "top", "right", "left", "bottom")


def draw_road(ax: Axes, scene: Scene) -> None:
    """Draw the lanes into matplotlib axes, along the reference line; those without end between its ends."""
    road = scene.road
    lanes = list_lanes(road)
    for index, lane in enumerate(lanes):
        s = np.clip(lane.stations, road.begin, road.end)
        is_special = index in (*road.access_ramp, *road.shoulder, *road.opposing)
        ax.fill_between(
            s, lane.right, lane.left, color="#e2e6ea" if is_special else "#eef0f2", lw=0, zorder=0
        )
    for marking in list_markings(road):
        width, dashes = (0.8, (0, (8, 8))) if marking.inner else (1.2, "-")
        s = np.clip(marking.x, road.begin, road.end)
        ax.plot(s, marking.y, color="#9aa3ad", lw=width, ls=dashes, zorder=1)
    ax.set_xlim(road.begin, road.end)
    low, high = min(float(lane.right.min()) for lane in lanes), max(float(lane.left.max()) for lane in lanes)
    ax.set_ylim(low - 0.8, high + 0.8)
    ax.set_aspect("equal")
    if not road.lanes:
        ax.set_yticks(road.lane_centres)
    ax.tick_params(labelsize=7)
    hide_spines(ax, "top", "right", "left", "bottom")


def _widen_limits(ax: Axes, frame: Frame) -> None:
    # Vehicles beside the lanes, as on a ramp, and the label of the highest one must fit.
    left, right = ax.get_xlim()
    ego, others = frame.world.ego, frame.world.others
    x, y = np.append(others.x[0], ego.x[0]), np.append(others.y[0], ego.y[0])
    heights = y[(x >= left) & (x <= right)]
    low, high = ax.get_ylim()
    if heights.size:
        ax.set_ylim(min(low, heights.min() - 1.8), max(high, heights.max() + 4.0))


def draw_frame(
    ax: Axes, frame: Frame, scene: Scene, clock: str | None = None, marked: frozenset[str] = frozenset()
) -> None:
    """Draw the vehicles of one moment into matplotlib axes, those ``marked`` by name highlighted.

    ``clock`` is the time [s] as text, by default that from the start.
    """
    ego, others = frame.world.ego, frame.world.others
    for v, name in enumerate(scene.names):
        colour = _MARKED if name in marked else _OTHER if scene.moving[v] else _PARKED
        _draw_box(ax, others, (0, v), scene.lengths[v], scene.widths[v], colour, name)
    _draw_box(ax, ego, (0,), scene.ego_length, scene.ego_width, _EGO, "ego")
    if frame.plan is not None:
        ax.plot(frame.plan[:, 0], frame.plan[:, 1], color=_PLAN, lw=1.0, label="ego plan", zorder=4)
    if frame.prediction is not None:
        x, y = frame.prediction.x[0], frame.prediction.y[0]
        ax.plot(x.T, y.T, ":", color=_ESTIMATE, lw=1.1, zorder=4)
        ax.plot(x[:, 0], y[:, 0], "o", color=_ESTIMATE, ms=3.0, label="estimate, prediction", zorder=5)
    if frame.observation is not None:
        observation = frame.observation
        ax.plot(
            observation.x[0],
            observation.y[0],
            "x",
            color=_SEEN,
            ms=5.0,
            mew=1.4,
            label="observation",
            zorder=6,
        )
        missed = ~observation.detected[0, : len(scene.names)]
        x, y = others.x[0, missed], others.y[0, missed]
        ax.plot(x, y, "s", mfc="none", color=_SEEN, ms=9.0, label="missed", zorder=6)
    text = f"{clock or f'{frame.t * scene.dt:.1f}'} s\n{ego.speed[0]:.1f} m/s"
    ax.text(1.005, 0.5, text, transform=ax.transAxes, fontsize=8, va="center")


def _draw_box(
    ax: Axes, vehicle: Vehicles, at: tuple[int, ...], length: float, width: float, colour: str, name: str
) -> None:
    x, y, heading = (np.asarray(getattr(vehicle, key)[at]) for key in ("x", "y", "heading"))
    corners = Rectangle(x, y, heading, np.asarray(length), np.asarray(width)).corners()
    ax.fill(*corners, facecolor=colour, edgecolor="white", lw=0.6, alpha=0.9, zorder=3)
    above = y + 0.5 * width + 0.25
    box = {"facecolor": "#eef0f2", "edgecolor": "none", "pad": 0.3, "alpha": 0.8}
    ax.text(
        float(x),
        float(above),
        plain(name),
        fontsize=6,
        color=colour,
        ha="center",
        va="bottom",
        zorder=7,
        clip_on=True,
        bbox=box,
    )


_MAX_PANELS = 8
_SAFE, _VIOLATED = "#1b6ca8", "#b0443c"


def plot_trace(trace: Trace, signals: Sequence[str]) -> Plot:
    """Draw signals of a trace; see ``Trace.plot``."""
    names = _choose_signals(trace, signals)
    figure = make_figure(8.0, 0.7 + 1.3 * len(names))
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    colour = _VIOLATED if trace.violated else _SAFE
    for ax, name in zip(axes, names, strict=True):
        values = np.asarray(trace[name], dtype=np.float64).reshape(len(trace.times), -1)
        labels = _label_columns(trace, name, values.shape[1])
        for column, label in zip(values.T, labels, strict=True):
            ax.plot(trace.times, column, lw=1.4, color=colour if len(labels) == 1 else None, label=label)
        if 1 < len(labels) <= _MAX_PANELS:
            ax.legend(fontsize=7, frameon=False, ncols=2)
        ax.set_ylabel(name, fontsize=8)
        ax.tick_params(labelsize=8)
        ax.margins(x=0.0)
        hide_spines(ax, "top", "right")
    axes[-1].set_xlabel("time [s]" if trace.unit == "s" else "step", fontsize=9)
    figure.suptitle(trace.describe(), fontsize=10)
    return Plot(figure)


def _choose_signals(trace: Trace, signals: Sequence[str]) -> list[str]:
    for name in signals:
        if name not in trace:
            raise UsageError(f"the trace has no signal {name!r}", did_you_mean(name, trace))
    if signals:
        return list(signals)
    numbers = [name for name, values in trace.items() if np.asarray(values).dtype.kind in "fiub"]
    return ([name for name in numbers if name in trace.formula] or numbers)[:_MAX_PANELS]


def _label_columns(trace: Trace, name: str, count: int) -> list[str]:
    if trace.scene is not None and count == len(trace.scene.names):
        return list(trace.scene.names)
    return [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]
