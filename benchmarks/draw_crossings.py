"""Draws simulated scenes of a crossroads, with their verdicts, for docs/traffic-rules.md.

    python benchmarks/draw_crossings.py --out docs/rules/crossings.png

The ego is blue; outlines are earlier samples, a second apart; the conflict areas on its way are yellow.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from draw_rules import AREA, EGO, LIGHTS, OTHER, ROAD, TEXT, VERDICT
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from avrare.driving import Action
from avrare.driving.frames import to_plane
from avrare.driving.geometry import Rectangle
from avrare.stack.builder import build_rule
from avrare_single_track.file_config import RecordedConfig
from avrare_single_track.recorded import RecordedScene

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from intersection_scenes import (
    LENGTH,
    RIGHT_OF_WAY,
    TURNS,
    WIDTH,
    crossroads,
    drives,
    road_end,
    route,
    way_through,
)

CHOSEN = {
    "from the right, 1.19 s later": 22,
    "from the right, 0.81 s later": 22,
    "the other has to brake": 26,
    "yields to nobody from the left": 26,
    "turns left before oncoming traffic": 26,
    "yellow while it could stop": 14,
}
"""Scenes, and the step that is shown."""


def draw(path: Path) -> None:
    """Draw the chosen scenes into one picture."""
    figure = Figure(figsize=(9.0, 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for ax, (title, step) in zip(figure.subplots(2, 3).flat, CHOSEN.items(), strict=True):
        _draw_scene(ax, title, step)
    figure.savefig(path, pil_kwargs={"optimize": True})


def _draw_scene(ax: Any, title: str, shown: int) -> None:
    rule, cars, more, _ = RIGHT_OF_WAY[title]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.xml"
        file.write_text(crossroads([*cars, drives(0, "right", 0.0)], **more), encoding="utf-8")
        body = {"length": LENGTH, "width": WIDTH, "wheelbase": 2.7}
        sim = RecordedScene(RecordedConfig(file=file, without=(1,), ego=body, route=route(cars[0])))
    specification = build_rule(rule, [], sim.scene)
    worlds, violated = _drive(sim, specification)
    for arm in range(4):
        ways = [way_through(arm, turn) for turn in TURNS] + [road_end(arm, 0.0), road_end(arm, 0.0, True)]
        for way in ways:
            ax.plot(*way.T, color=ROAD, lw=16.0, solid_capstyle="butt", zorder=0)
    for area in sim.scene.road.crossings:
        s, d = (
            np.array([area.line_begin, area.line_end, area.line_end, area.line_begin]),
            area.half_width * np.array([-1.0, -1.0, 1.0, 1.0]),
        )
        ax.add_patch(Polygon(np.stack(area.line.to_plane(s, d), axis=1), fc=AREA, ec="none", zorder=1))
    for x in sim.scene.road.light_lines:
        colour = LIGHTS[int(sim.signals(worlds[shown])["light_0"][0])]
        ends = sim.scene.road.line.to_plane(np.full(2, x), np.array([-1.75, 1.75]))
        ax.plot(*ends, color=colour, lw=3.0, zorder=1)
    for t in (shown - 20, shown - 10, shown):
        if t >= 0:
            _draw_cars(ax, sim, worlds[t], filled=t == shown)
    word, colour = VERDICT[violated]
    ax.set_title(f"{rule} {word}: {title}", loc="left", fontsize=7.5, color=colour)
    ax.set(xlim=(-24.0, 24.0), ylim=(-24.0, 24.0), xticks=[], yticks=[], aspect="equal")
    ax.text(-23.0, -23.0, f"at {0.1 * shown:.1f} s", fontsize=7, color=TEXT)


def _drive(sim: RecordedScene, rule: Any) -> tuple[list[Any], bool]:
    line: Any = sim.scene.road.line
    worlds, state = [sim.reset(np.zeros((1, 0)))], rule.start(1)
    state, verdict = rule.update(state, sim.signals(worlds[0]))
    for _ in range(78):
        ego = worlds[-1].ego
        turn = line.curvature(ego.x + 0.1 * ego.speed) * ego.speed - ego.speed * (0.3 * ego.y + ego.heading)
        worlds.append(sim.step(worlds[-1], Action(np.zeros(1), turn), np.zeros((1, 0))))
        state, verdict = rule.update(state, sim.signals(worlds[-1]))
    return worlds, bool(verdict.violated[0])


def _draw_cars(ax: Any, sim: RecordedScene, world: Any, filled: bool) -> None:
    for vehicles, colour in ((world.others, OTHER), (world.ego, EGO)):
        plane = to_plane(sim.scene.road, vehicles)
        rows = zip(*(np.ravel(getattr(plane, name)) for name in ("x", "y", "heading")), strict=True)
        for x, y, heading in rows:
            if abs(x) < 40.0 and abs(y) < 40.0:
                box = Rectangle(*(np.asarray(v) for v in (x, y, heading, LENGTH, WIDTH)))
                corners = np.stack(box.corners(), axis=-1)
                fill = colour if filled else "none"
                ax.add_patch(
                    Polygon(corners, fc=fill, ec=colour, lw=0.9, alpha=1.0 if filled else 0.5, zorder=2)
                )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/rules/crossings.png"))
    draw(parser.parse_args().out)


if __name__ == "__main__":
    main()
