"""Picture of a scene that is acted out without a stack."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from avrare.protocols import Floats
from avrare_openscenario.network import RoadMap
from avrare_openscenario.scenario_file import ScenarioFile
from avrare_openscenario.trace import act_out

_MARGIN = 20.0
"""Road that is drawn around the vehicles [m]."""


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
