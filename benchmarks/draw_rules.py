"""Draws the hand-made situations of the traffic rules for the reference page of every rule.

    python benchmarks/draw_rules.py --out docs/rules

One picture for each rule: a pass, a fail, the boundary and an exemption, from above, relative to the ego.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.transforms import blended_transform_factory

from avrare.driving.geometry import Rectangle

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from traffic_situations import SITUATIONS, Situation
from traffic_situations.situation import LENGTH, WIDTH

KINDS = ("pass", "fail", "boundary", "exempt")
EGO, OTHER, PARKED = "#1b6ca8", "#6b7a8f", "#b0443c"
VERDICT = {True: ("broken", "#b3261e"), False: ("kept", "#2e7d32")}
ROAD, SIDE, LINE, TEXT = "#eceef0", "#dcdfe3", "#9aa3ad", "#4a5258"
AREA = "#f2d9a8"
LIGHTS = ("#2e7d32", "#e0a800", "#c62828")
PLATE = {"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6}
LEAST_RANGE = 62.0
LABEL = 0.02
"""Height of a label above the road, as a share of what is shown of it."""

INCHES = 9.0


def draw_rule(rule: str, folder: Path) -> Path:
    """Draw four panels below one another, as a PNG of few colours."""
    chosen = [next(s for s in SITUATIONS if (s.rule, s.kind) == (rule, kind)) for kind in KINDS]
    low, high = _range(chosen)
    bottom, top = _sides(chosen)
    height = INCHES * ((top - bottom + 0.4) / (high - low) + LABEL)
    figure = Figure(figsize=(INCHES, len(chosen) * (height + 0.42) + 0.3), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for ax, situation in zip(figure.subplots(len(chosen), 1, sharex=True), chosen, strict=True):
        _draw_road(ax, situation, low, high)
        _draw_crossings(ax, situation)
        ax.set_ylim(bottom - 0.4, top + LABEL * (high - low))
        _draw_cars(ax, situation)
        _write(ax, situation)
    ax.tick_params(labelbottom=True)
    ax.set_xlabel("ahead of the ego [m]", fontsize=8, color=TEXT)
    path = folder / f"{rule}.png"
    figure.savefig(path, pil_kwargs={"optimize": True})
    _fewer_colours(path)
    return path


def _range(situations: list[Situation]) -> tuple[float, float]:
    """Return the stretch of road shown in all panels."""
    ahead = [x for s in situations for car in _relative(s).values() for x, _ in car] or [0.0]
    low, high = min(0.0, *ahead) - 7.0, max(0.0, *ahead) + 9.0
    room = max(LEAST_RANGE - (high - low), 0.0)
    return low - 0.25 * room, high + 0.75 * room


def _sides(situations: list[Situation]) -> tuple[float, float]:
    """Return the stretch across the road shown in all panels: its lanes, and cars beside them."""
    found = [(s.road.lane_centres[0] - 1.75, s.road.lane_centres[-1] + 1.75) for s in situations]
    crossed = [s for s in situations if s.road.crossings]
    aside = [y for s in crossed for car in _relative(s).values() for _, y in car]
    low, high = min(y for y, _ in found), max(y for _, y in found)
    return min([low, *(y - 3.0 for y in aside)]), max([high, *(y + 3.5 for y in aside)])


def _draw_crossings(ax: Any, situation: Situation) -> None:
    ego = float(situation.ego.over(situation.steps, situation.dt)["x"][-1])
    road = situation.road
    ends = road.lane_centres[0] - 0.5 * road.lane_width, road.lane_centres[-1] + 0.5 * road.lane_width
    for x in road.stop_signs:
        ax.vlines(x - ego, *ends, color=TEXT, lw=2.5, zorder=1)
    for x in road.light_lines:
        ax.vlines(x - ego, *ends, color=LIGHTS[int(situation.light[-1])], lw=3.5, zorder=1)
    for one in road.crossings:
        for begin, end, colour in ((-90.0, 90.0, ROAD), (one.line_begin, one.line_end, AREA)):
            s, d = np.array([begin, end, end, begin]), one.half_width * np.array([-1.0, -1.0, 1.0, 1.0])
            corners = np.stack(one.line.to_plane(s, d), axis=1) - (ego, 0.0)
            ax.add_patch(Polygon(corners, fc=colour, ec="none", zorder=1.5))


def _relative(situation: Situation) -> dict[str, list[tuple[float, float]]]:
    """Return car -> (x, y) at each sample, x counted from the ego."""
    ego = situation.ego.over(situation.steps, situation.dt)
    tracks = {name: car.over(situation.steps, situation.dt) for name, car in situation.others.items()}
    return {
        name: [(float(x), float(y)) for x, y in zip(track["x"] - ego["x"], track["y"], strict=True)]
        for name, track in {"ego": ego, **tracks}.items()
    }


def _draw_road(ax: Any, situation: Situation, low: float, high: float) -> None:
    road = situation.road
    half = 0.5 * road.lane_width
    apart = {*road.access_ramp, *situation.options.get("shoulder", ())}
    for lane, centre in enumerate(road.lane_centres):
        ax.axhspan(centre - half, centre + half, color=SIDE if lane in apart else ROAD, lw=0)
        if lane:
            ax.axhline(centre - half, color=LINE, lw=1.0, ls=(0, (7, 5)))
    bottom, top = road.lane_centres[0] - half, road.lane_centres[-1] + half
    ax.hlines([bottom, top], low, high, color=LINE, lw=1.5)
    edge = blended_transform_factory(ax.transAxes, ax.transData)
    for lane in sorted(apart):
        word = "ramp" if lane in road.access_ramp else "shoulder"
        style = {"fontsize": 7, "color": TEXT, "ha": "right", "va": "center"}
        ax.text(0.994, road.lane_centres[lane], word, transform=edge, **style)
    ax.set(xlim=(low, high), yticks=[])
    ax.set_aspect("equal", adjustable="box")
    ax.tick_params(labelsize=7, colors=TEXT, length=2)
    for spine in ax.spines.values():
        spine.set_visible(False)


def _draw_cars(ax: Any, situation: Situation) -> None:
    relative, last = _relative(situation), situation.steps - 1
    for name, places in relative.items():
        car = situation.ego if name == "ego" else situation.others[name]
        colour = EGO if name == "ego" else OTHER if car.moving else PARKED
        headings = car.over(situation.steps, situation.dt)["heading"]
        for t, ((x, y), heading) in enumerate(zip(places, headings, strict=True)):
            box = Rectangle(*(np.asarray(v) for v in (x, y, heading, LENGTH, WIDTH)))
            corners = np.stack(box.corners(), axis=-1)
            fill = colour if t == last else "none"
            ax.add_patch(
                Polygon(corners, fc=fill, ec=colour, lw=0.9, alpha=1.0 if t == last else 0.5, zorder=2)
            )
        x, y = places[last]
        nose = 0.5 * LENGTH * np.array([np.cos(headings[last]), np.sin(headings[last])])
        ax.plot(*np.array([x, y])[:, None] + np.outer(nose, (0.55, 1.0)), color="white", lw=1.6, zorder=3)
        label = f"{name}  {car.speed:.4g} m/s" + (f", {car.acceleration:g} m/s²" if car.acceleration else "")
        # below the ego, above the others: they may be close
        low, high = corners[:, 1].min() - 0.2, corners[:, 1].max() + 0.2
        place, side = (low, "top") if name == "ego" else (high, "bottom")
        ax.text(x, place, label, fontsize=6.5, color=colour, ha="center", va=side, bbox=PLATE, zorder=4)


def _write(ax: Any, situation: Situation) -> None:
    value, violated = situation.evaluate()
    word, colour = VERDICT[violated]
    if situation.kind == "boundary":
        word, colour = "boundary", TEXT
    ax.set_title(f"{word}: {situation.title}", loc="left", fontsize=9.5, color=colour, pad=3)
    robustness = "∞" if np.isinf(value) else f"{round(value, 9) + 0.0:.3f}"
    ax.set_title(
        f"{situation.because}      robustness {robustness}", loc="right", fontsize=7.5, color=TEXT, pad=3
    )


def _fewer_colours(path: Path) -> None:
    from PIL import Image

    with Image.open(path) as image:
        small = image.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/rules"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for rule in dict.fromkeys(situation.rule for situation in SITUATIONS):
        path = draw_rule(rule, options.out)
        print(f"{path}  {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
