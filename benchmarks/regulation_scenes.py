"""Scenes of UN R157 (openMSL) and Euro NCAP (Vector) as they are found, driven by stacks of this repository.

    python -m benchmarks.regulation_scenes alks FOLDER --rollouts 50
    python -m benchmarks.regulation_scenes ncap FOLDER --rollouts 50

FOLDER has the files. ``docs/regulation/alks.csv`` gets a row for each scene and stack, and ``alks.png`` a
picture of each scene without noise. What cannot be driven is a row with the reason.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import avrare
from avrare.base.errors import AvrareError
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare_openscenario.scenario_file import read_scenario
from avrare_openscenario.trace import act_out

BASE = "scenarios/_base/recorded_cut_in.yaml"
OUT = Path("docs/regulation")
AEB = "{time_to_collision: 1.2}"
MPC = {
    "plugin": "mpc",
    "horizon": 30,
    "clearance_x": 8.0,
    "stop_braking": 3.5,
    "lateral_acceleration_max": 4.0,
    "acceleration_max": 6.0,
    "turn_rate_weight": 2000.0,
    "turn_rate_change_weight": 150000.0,
    "smooth_start": True,
}
DT = 0.1
"""Step of the paths [s]."""
HEADS = ("scene", "stack", "steps", "probability", "low", "high", "rollouts", "errors", "seconds", "reason")


@dataclass(frozen=True)
class Kind:
    """Collection of scenes.

    Attributes:
        pattern: Of the files.
        prefix: Of their names, which is left out.
        steps: Of a rollout.
        stacks: Controllers.
    """

    pattern: str
    prefix: str
    steps: int
    stacks: tuple[str, ...]


KINDS = {
    "alks": Kind("*_template.xosc", "alks_scenario_", 400, ("cruise", "mpc")),
    "ncap": Kind("NCAP_AEB_*_20??.xosc", "NCAP_AEB_", 220, ("hold",)),
}


def find_files(folder: Path, pattern: str) -> list[Path]:
    """Return the scenes below a folder, without files of distributions."""
    return sorted(path for path in folder.rglob(pattern) if "Variation" not in str(path))


def find_path(file: Path, seconds: float) -> list[tuple[float, float]]:
    """Return x and y along its road of the way that the file has the ego drive, every half a metre."""
    acted, driven = (read_scenario(str(file), ego, DT, {}, ignore_ego=True) for ego in (None, "Ego"))
    k = [body.name for body in acted.bodies].index("Ego")
    x, y, heading, _ = act_out(acted, DT, seconds)[1][:, k].T
    ahead = acted.bodies[k].ahead
    x, y = driven.roads.line.to_road(x + ahead * np.cos(heading), y + ahead * np.sin(heading))
    path: list[tuple[float, float]] = []
    for point in zip(x.tolist(), y.tolist(), strict=True):
        if not path or np.hypot(*np.subtract(point, path[-1])) > 0.5:
            path.append(point)
    return path if len(path) > 1 else []


def open_scene(file: Path, stack: str, kind: Kind) -> LoadedScenario:
    """Return the scene with a stack behind the sensor of the shipped cut-ins."""
    simulator = {"plugin": "openscenario", "file": str(file.resolve()), "ignore_ego_events": True}
    settings = [f"name={stack}", f"steps={kind.steps}", f"aeb={AEB}"]
    controller: dict[str, object] = {"plugin": stack}
    if stack == "mpc":
        loop = avrare.load(BASE, [*settings, f"simulator={json.dumps(simulator)}"]).stack.loop
        ego, road = loop.initial(np.zeros((1, loop.noise_size))).world.ego, loop.scene.road
        lane = int(np.abs(np.array(road.lane_centres) - ego.y[0]).argmin())
        controller = MPC | {"lanes": [lane], "y_goal": float(ego.y[0]), "v_goal": float(ego.speed[0])}
    if stack == "hold":
        controller["path"] = find_path(file, 0.1 * kind.steps)
    settings += [f"simulator={json.dumps(simulator)}", f"controller={json.dumps(controller)}"]
    return avrare.load(BASE, settings)


def record_drive(problem: avrare.Problem) -> tuple[Floats, Floats]:
    """Return x and y (steps + 1, 1 + V) of ego and others without noise."""
    loop = problem.system
    noise = np.asarray(loop.perfect_noise)[None]
    states = [loop.initial(noise)]
    for _ in range(problem.steps):
        states.append(loop.step(states[-1], noise))
    worlds = [state.world for state in states]
    x, y = (
        np.array([[getattr(w.ego, axis)[0], *getattr(w.others, axis)[0]] for w in worlds]) for axis in "xy"
    )
    return x, y


def draw_drive(axes: Axes, title: str, problem: avrare.Problem) -> None:
    """Draw the ways of the ego (blue) and the others, marked every two seconds, and their nearest places."""
    (x, y), scene = record_drive(problem), problem.scene
    for centre in scene.road.lane_centres:
        for edge in (centre - scene.road.lane_width / 2.0, centre + scene.road.lane_width / 2.0):
            axes.axhline(edge, color="0.85", linewidth=0.6)
    nearest = np.hypot(x[:, 1:] - x[:, :1], y[:, 1:] - y[:, :1]).min(axis=1, initial=1e9).argmin()
    sizes = [(scene.ego_length, scene.ego_width), *zip(scene.lengths, scene.widths, strict=True)]
    for k, (length, width) in enumerate(sizes):
        colour, close = ("tab:orange" if k else "tab:blue"), np.abs(x[:, k] - x[nearest, 0]) < 150.0
        axes.plot(x[close, k], y[close, k], ".-", color=colour, markevery=20, markersize=4, linewidth=0.8)
        corner = x[nearest, k] - length / 2.0, y[nearest, k] - width / 2.0
        if close[nearest]:
            axes.add_patch(Rectangle(corner, length, width, fill=False, edgecolor=colour))
    middle = y[nearest, 0]
    axes.set_ylim(middle - 6.0, middle + 6.0)
    axes.set_title(title, fontsize=7)
    axes.tick_params(labelsize=6)


def draw_sheet(drives: list[tuple[str, avrare.Problem]], path: Path) -> None:
    """Write a picture of all drives, two in a row."""
    rows = (len(drives) + 1) // 2
    figure = Figure(figsize=(13.0, 1.4 * rows))
    for k, drive in enumerate(drives):
        draw_drive(figure.add_subplot(rows, 2, k + 1), *drive)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Drive the scenes and write the table and the picture."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rollouts", type=int, default=50)
    args = parser.parse_args()
    kind, drives = KINDS[args.kind], []
    OUT.mkdir(exist_ok=True)
    with open(OUT / f"{args.kind}.csv", "w", newline="") as table:
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(HEADS)
        for file, stack in product(find_files(args.folder, kind.pattern), kind.stacks):
            name, begun = file.stem.removeprefix(kind.prefix).removesuffix("_template"), time.process_time()
            try:
                problem = open_scene(file, stack, kind).problem("no_collision")
                result = avrare.estimate(problem, "mc", rollouts=args.rollouts, seed=0)
            except AvrareError as error:
                reason = error.lines()[0].rsplit(".xosc:", 1)[-1].strip()
                row: tuple[object, ...] = (*[""] * 6, reason)
            else:
                numbers = (f"{x:.3g}" for x in (result.probability, *result.interval))
                row = (*numbers, result.rollouts, result.errors, f"{time.process_time() - begun:.2g}", "")
                if result.errors < result.rollouts:
                    drives.append((f"{name}, {stack}: {result.probability:.2g}", problem))
            writer.writerow((name, stack, kind.steps, *row))
            table.flush()
    draw_sheet(drives, OUT / f"{args.kind}.png")


if __name__ == "__main__":
    main()
