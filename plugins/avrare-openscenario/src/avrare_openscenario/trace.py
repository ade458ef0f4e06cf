"""States of a scene that is acted out without a stack, in the plane of its road file."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats
from avrare_openscenario.acted_traffic import ActedTraffic
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import ScenarioFile


def act_out(file: ScenarioFile, dt: float, until: float) -> tuple[Floats, Floats]:
    """Return times (T,) and states (T, V, 4): x, y, heading and speed of each point of reference.

    Args:
        file: The scene, all of whose entities obey the storyboard.
        dt: Step [s].
        until: End [s].
    """
    traffic = ActedTraffic(file, dt)
    states = [_describe(traffic.maps, points) for points in _drive(traffic, until)]
    return np.arange(len(states), dtype=np.float64) * dt, np.stack(states)


def _drive(traffic: ActedTraffic, until: float) -> Iterator[Vehicles]:
    _, memory = traffic.start(1, {})
    yield memory.points
    for step in range(round(until / traffic.dt)):
        memory = traffic.step(memory, np.array([step]), None)
        yield memory.points


def write_trace(path: Path, file: ScenarioFile, dt: float, until: float) -> None:
    """Write the columns time, entity, x, y, heading, speed."""
    times, states = act_out(file, dt, until)
    with path.open("w", newline="", encoding="utf-8") as target:
        writer = csv.writer(target)
        writer.writerow(("time", "entity", "x", "y", "heading", "speed"))
        for time, row in zip(times, states, strict=True):
            for body, state in zip(file.bodies, row, strict=True):
                writer.writerow((f"{time:.6g}", body.name, *(f"{number:.6f}" for number in state)))


def _describe(maps: Sequence[RoadMap], points: Vehicles) -> Floats:
    states = []
    for k, roads in enumerate(maps):
        x, y = roads.line.to_plane(points.x[:, k], points.y[:, k])
        heading = points.heading[0, k] + roads.line.heading(points.x[:, k])[0]
        states.append((x[0], y[0], heading, points.speed[0, k]))
    return np.array(states)
