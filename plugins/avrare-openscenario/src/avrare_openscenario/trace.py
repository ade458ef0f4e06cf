"""States of a scene that is acted out without a stack, in the plane of its road file, and their picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats
from avrare_openscenario.acted_traffic import ActedTraffic
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import ScenarioFile
from avrare_openscenario.starts import move_over, pick

_MARGIN = 20.0
"""Road that is drawn around the vehicles [m]."""


def act_out(file: ScenarioFile, dt: float, until: float) -> tuple[Floats, Floats]:
    """Return times (T,) and states (T, V, 4): x, y, heading and speed of each point of reference."""
    traffic = ActedTraffic(file, dt)
    _, memory = traffic.start(1, {})
    states = [_compute_plane_states(traffic.maps, memory.points)]
    for step in range(round(until / dt)):
        memory = traffic.step(memory, np.array([step]), None)
        states.append(_compute_plane_states(traffic.maps, memory.points))
    return np.arange(len(states), dtype=np.float64) * dt, np.stack(states)


def write_trace(path: Path, file: ScenarioFile, dt: float, until: float) -> None:
    """Write the columns time, entity, x, y, heading, speed."""
    times, states = act_out(file, dt, until)
    with path.open("w", newline="", encoding="utf-8") as target:
        writer = csv.writer(target)
        writer.writerow(("time", "entity", "x", "y", "heading", "speed"))
        for time, row in zip(times, states, strict=True):
            for body, state in zip(file.bodies, row, strict=True):
                writer.writerow((f"{time:.6g}", body.name, *(f"{number:.6f}" for number in state)))


def _compute_plane_states(maps: Sequence[RoadMap], points: Vehicles) -> Floats:
    states = []
    for k, roads in enumerate(maps):
        point = pick(points, slice(k, k + 1))
        if roads.legs and (leg := roads.find_leg(point.x.item()).roads).tilt is not None:
            point, roads = move_over(point, roads, leg), leg
        s, d, heading = roads.see_from_above(point.x[0], point.y[0], point.heading[0])
        x, y = roads.line.to_plane(s, d)
        states.append((x[0], y[0], (heading + roads.line.heading(s))[0], point.speed[0, 0]))
    return np.array(states)


def draw_scene(path: Path, file: ScenarioFile, dt: float, until: float) -> None:
    """Write a picture of the lanes and of the ways of all points of reference, a dot every second."""
    from matplotlib.figure import Figure

    times, states = act_out(file, dt, until)
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    for roads in file.network.maps:
        for x, y in _list_borders(roads):
            axes.plot(x, y, color="0.75", linewidth=0.8)
    every = max(round(1.0 / dt), 1)
    for k, body in enumerate(file.bodies):
        x, y = states[:, k, 0], states[:, k, 1]
        (line,) = axes.plot(x, y, linewidth=1.5, label=body.name)
        axes.plot(x[::every], y[::every], ".", color=line.get_color(), markersize=5.0)
    low, high = np.nanmin(states[:, :, :2], axis=(0, 1)), np.nanmax(states[:, :, :2], axis=(0, 1))
    axes.set_xlim(low[0] - _MARGIN, high[0] + _MARGIN)
    axes.set_ylim(low[1] - _MARGIN, high[1] + _MARGIN)
    axes.set_aspect("equal")
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{Path(file.path).name}, 0 to {times[-1]:g} s")
    axes.legend(loc="best", fontsize="small")
    figure.savefig(path, dpi=120)


def _list_borders(roads: RoadMap) -> list[tuple[Floats, Floats]]:
    # Both borders of each lane in the plane.
    stations = np.linspace(0.0, roads.line.length, max(2, int(roads.line.length)))
    lanes = range(len(roads.road.lane_centres))
    return [roads.line.to_plane(stations, side) for lane in lanes for side in roads.borders(lane, stations)]
