"""Pictures of a drive: road, true boxes, observations, estimates and predictions at a few moments."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.driving import Scene
from avrare.driving.geometry import Rectangle
from avrare.estimation.result import Result
from avrare.protocols import Floats

_MOMENTS = 6
_WIDTH, _ROW = 12.0, 1.05
"""Of the picture, and the least height of a moment [inches]."""
_LONGEST = 300.0
"""A road beyond this [m] is not drawn whole: cars would be specks."""
_BEHIND, _AHEAD = 70.0, 150.0
"""What is drawn of it then, from the ego [m]."""
_EGO, _OTHER, _PARKED, _MARKED = "#1b6ca8", "#6b7a8f", "#b0443c", "#d9701a"
_SEEN, _ESTIMATE, _PLAN = "#e08a1e", "#7b3fa0", "#1b6ca8"


@dataclass(frozen=True)
class Frame:
    """One moment of one particle.

    Attributes:
        t: Step.
        world: Of one particle (N = 1).
        observation: Of one particle, or None.
        prediction: Of one particle, or None.
        plan: (H + 1, >= 2) planned x and y, or None.
    """

    t: int
    world: Any
    observation: Any
    prediction: Any
    plan: Floats | None


def available() -> bool:
    """Whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def draw_run(scenario: BuildableScenario, results: Sequence[Result], folder: Path) -> list[Path]:
    """Draw the noise-free drive and the worst rollout of each result into ``folder``."""
    problem = scenario.problem(scenario.specifications)
    quiet = np.zeros((problem.steps + 1, problem.noise_size))
    tapes = [("nominal", "noise-free drive", quiet)]
    for result in results:
        if not np.isnan(result.worst.robustness):
            least = f"robustness {result.worst.robustness:.3g}"
            title = f"{result.specification}: worst of {result.rollouts} rollouts, {least}"
            tapes.append((f"worst_{result.specification}", title, result.worst.noise))
    drives = replay_frames(scenario, np.stack([tape for _, _, tape in tapes]))
    paths = []
    for (name, title, _), (frames, _) in zip(tapes, drives, strict=True):
        path = folder / f"{name}.png"
        draw_drive(frames, _scene(scenario), f"{scenario.name}: {title}", path)
        paths.append(path)
    return paths


def draw_drive(frames: Sequence[Frame], scene: Scene, title: str, path: Path) -> None:
    """Draw a few moments of a drive below one another as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chosen = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, _MOMENTS).round().astype(int))]
    figure = Figure(figsize=(_WIDTH, _ROW * len(chosen) + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    follow = scene.road.end - scene.road.begin > _LONGEST
    axes = np.atleast_1d(figure.subplots(len(chosen), 1, sharex=not follow, sharey=True))
    for ax, frame in zip(axes, chosen, strict=True):
        draw_road(ax, scene)
        if follow:
            x = float(frame.world.ego.x[0])
            ax.set_xlim(x - _BEHIND, x + _AHEAD)
        draw_frame(ax, frame, scene)
    for ax, frame in zip(axes, chosen, strict=True):  # they share an axis, which each road has set anew
        _make_room(ax, frame)
    (left, right), (low, high) = axes[-1].get_xlim(), axes[-1].get_ylim()
    row = (high - low) / (right - left) * _WIDTH + (0.35 if follow else 0.15)
    figure.set_figheight(max(row, _ROW) * len(chosen) + 0.9)
    axes[-1].set_xlabel("x [m]")
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    handles, labels = axes[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)


def replay_frames(
    scenario: BuildableScenario, tapes: Floats
) -> list[tuple[list[Frame], list[dict[str, Any]]]]:
    """Drive tapes (N, steps + 1, noise_size) again: of each its frames and its signals, sample by sample.

    A rollout that breaks down ends there; without vehicles there are no frames.
    """
    problem = scenario.problem(scenario.specifications)
    loop = scenario.stack.loop
    drives: list[tuple[list[Frame], list[dict[str, Any]]]] = [([], []) for _ in tapes]
    for t, rows, carry in problem.replay(tapes, keep_carries=True).carries:
        state = carry.system
        signals = loop.signals(state)
        horizon = loop.controller.horizon if loop.controller is not None else 0
        prediction = loop.tracker.predict(state.track, horizon) if loop.tracker is not None else None
        for position, row in enumerate(rows):
            one = slice(position, position + 1)
            drives[row][1].append({key: np.asarray(values)[one] for key, values in signals.items()})
            if scenario.scene is not None:
                drives[row][0].append(_frame(t, state, prediction, position))
    return drives


def _frame(t: int, state: Any, prediction: Any, position: int) -> Frame:
    from avrare.batch import take

    one = slice(position, position + 1)
    states = getattr(state.memory, "plan_states", None)
    return Frame(
        t,
        take(state.world, one),
        None if state.observation is None else take(state.observation, one),
        None if prediction is None else take(prediction, one),
        None if states is None or t == 0 else states[position],
    )


def draw_road(ax: Any, scene: Scene) -> None:
    """Draw the lanes into matplotlib axes."""
    road = scene.road
    edges = [centre - 0.5 * road.lane_width for centre in road.lane_centres]
    edges.append(road.lane_centres[-1] + 0.5 * road.lane_width)
    ax.axhspan(edges[0], edges[-1], color="#eef0f2", zorder=0)
    for lane in road.access_ramp:
        ax.axhspan(edges[lane], edges[lane + 1], color="#e2e6ea", zorder=0)
    for index, y in enumerate(edges):
        outer = index in (0, len(edges) - 1)
        ax.axhline(y, color="#9aa3ad", lw=1.2 if outer else 0.8, ls="-" if outer else (0, (8, 8)), zorder=1)
    ax.set_xlim(road.begin, road.end)
    ax.set_ylim(edges[0] - 0.8, edges[-1] + 0.8)
    ax.set_aspect("equal")
    ax.set_yticks(road.lane_centres)
    ax.tick_params(labelsize=7)
    for side in ("top", "right", "left", "bottom"):
        ax.spines[side].set_visible(False)


def _make_room(ax: Any, frame: Frame) -> None:
    """Widen the axes to vehicles beside the lanes, as on a ramp, and to the name above the highest one."""
    left, right = ax.get_xlim()
    x, y = (
        np.append(getattr(frame.world.others, key)[0], getattr(frame.world.ego, key)[0]) for key in ("x", "y")
    )
    seen = y[(x >= left) & (x <= right)]
    low, high = ax.get_ylim()
    if seen.size:
        ax.set_ylim(min(low, seen.min() - 1.8), max(high, seen.max() + 4.0))


def draw_frame(
    ax: Any, frame: Frame, scene: Scene, clock: str | None = None, marked: frozenset[str] = frozenset()
) -> None:
    """Draw the vehicles of one moment.

    Args:
        ax: Matplotlib axes.
        frame: The moment.
        scene: Names and sizes.
        clock: Its time [s] in words; by default it counts from the start.
        marked: Names of vehicles to point out.
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
        seen = frame.observation
        ax.plot(seen.x[0], seen.y[0], "x", color=_SEEN, ms=5.0, mew=1.4, label="observation", zorder=6)
        missed = ~seen.detected[0]
        ax.plot(
            others.x[0, missed],
            others.y[0, missed],
            "s",
            mfc="none",
            color=_SEEN,
            ms=9.0,
            label="missed",
            zorder=6,
        )
    ax.text(
        1.005,
        0.5,
        f"{clock or f'{frame.t * scene.dt:.1f}'} s\n{ego.speed[0]:.1f} m/s",
        transform=ax.transAxes,
        fontsize=8,
        va="center",
    )


def _draw_box(
    ax: Any, vehicle: Any, at: tuple[int, ...], length: float, width: float, colour: str, name: str
) -> None:
    x, y, heading = (np.asarray(getattr(vehicle, key)[at]) for key in ("x", "y", "heading"))
    corners = Rectangle(x, y, heading, np.asarray(length), np.asarray(width)).corners()
    ax.fill(*corners, facecolor=colour, edgecolor="white", lw=0.6, alpha=0.9, zorder=3)
    above = y + 0.5 * width + 0.25
    ax.text(
        float(x),
        float(above),
        name,
        fontsize=6,
        color=colour,
        ha="center",
        va="bottom",
        zorder=7,
        clip_on=True,
        bbox={"facecolor": "#eef0f2", "edgecolor": "none", "pad": 0.3, "alpha": 0.8},
    )


def _scene(scenario: BuildableScenario) -> Scene:
    assert scenario.scene is not None
    return scenario.scene
