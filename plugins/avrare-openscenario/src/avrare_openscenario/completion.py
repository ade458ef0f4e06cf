"""Options of the simulator that stand in its files: where they are, and laws of parameters."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from avrare.scenario.safe_mode import refuse_outside
from avrare_openscenario.distributions import read_distributions
from avrare_openscenario.scenario_file import read_scenario
from avrare_openscenario.xml_tree import read_xml


def complete(options: Mapping[str, Any], folder: str) -> dict[str, Any]:
    """Return the scenario's file, road and catalogs, beside the scenario if they are there, and laws.

    Raises:
        UsageError: Something in a file is not understood.
    """
    parameters, dt = options.get("parameters", {}), options.get("dt", 0.1)
    well_formed = isinstance(options.get("file"), str) and isinstance(parameters, Mapping)
    if not (well_formed and isinstance(dt, float | int) and 0.0 < dt <= 1.0):
        return {}  # the model says what is wrong

    def allow(path: str, what: str) -> None:
        refuse_outside(path, folder, what)

    file = _find(options["file"], folder)
    laws: dict[str, Any] = {}
    allow(file, "file")
    top = read_xml(file, "OpenSCENARIO")
    if top.find("ParameterValueDistribution") is not None:
        file, laws = read_distributions(top)
        allow(file, "ParameterValueDistribution: ScenarioFile")
    laws = {name: law for name, law in laws.items() if name not in parameters}
    numbers = {name: value for name, value in parameters.items() if isinstance(value, str | float | int)}
    road, catalogs = options.get("road"), options.get("catalogs")
    scene = read_scenario(
        file,
        str(options.get("entity", "Ego")),
        float(dt),
        numbers,
        _find(road, folder) if isinstance(road, str) else None,
        options.get("ignore_ego_events") is True,
        [_find(str(path), folder) for path in catalogs] if isinstance(catalogs, list | tuple) else (),
        allow,
    )
    files: dict[str, Any] = {"file": file, "road": scene.road_path}
    files |= {"catalogs": list(scene.catalog_paths)} if scene.catalog_paths else {}
    return {**files, **({"parameters": laws} if laws else {})}


def _find(path: str, folder: str) -> str:
    neighbour = os.path.join(folder, path)
    return neighbour if os.path.exists(neighbour) else path
