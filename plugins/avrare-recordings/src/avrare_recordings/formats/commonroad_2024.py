"""CommonRoad's format 2024: a scene in three protobuf files, read with the package ``commonroad-io``.

``MAP.pb`` has the lanelets, ``MAP_1_T-1.pb`` the obstacles, ``MAP_1_T-1-SC.pb`` the planning problems. Either
of the last two stands for the scene: the others lie beside it, under the names that it gives them.
"""

from __future__ import annotations

from glob import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from avrare.base.errors import UsageError

if TYPE_CHECKING:
    from commonroad.planning.planning_problem import PlanningProblemSet
    from commonroad.scenario.scenario import Scenario

SUFFIX = ".pb"
_PROBLEMS = "-SC"
_OLDER, _HEADER = b"\x052020a", 16
"""Version in the first bytes of the older files."""


def is_companion(path: Path) -> bool:
    """Return whether a file of the format only completes another file in its folder."""
    if path.suffix.lower() != SUFFIX:
        return False
    problems, rest = path.stem.endswith(_PROBLEMS), path.stem.removesuffix(_PROBLEMS)
    if problems:
        return path.with_name(rest + SUFFIX).exists()
    return any(path.parent.glob(f"{escape(path.stem)}_*{SUFFIX}"))


def open_2024(path: str) -> tuple[Scenario, PlanningProblemSet]:
    """Return the scenario and the planning problems of the scene that a file belongs to.

    Raises:
        UsageError: It is not a file of this format, or a file that it needs is not next to it.
    """
    reader = import_module("commonroad.common.file_reader").CommonRoadFileReader
    problems = import_module("commonroad.planning.planning_problem").PlanningProblemSet
    kind, message = _parse(path)
    here = Path(path)
    if kind == "map":
        network = import_module("commonroad.common.reader.file_reader_protobuf").ProtobufFileReaderMap
        scenario = import_module("commonroad.scenario.scenario").Scenario(0.1)
        scenario.add_objects(network(path).open()[0])
        return scenario, problems([])
    if kind == "dynamic":
        ids = message.dynamic_meta_information.benchmark_id.map_id
        files = {"map": f"{ids.country_id}_{ids.map_name}-{ids.map_id}", "dynamic": here.stem}
        asked = f"{here.stem}{_PROBLEMS}"
    else:
        files = {"map": message.map_id, "dynamic": message.dynamic_id}
        asked = here.stem
    places = {name: here.with_name(f"{stem}{SUFFIX}") for name, stem in files.items()}
    for name, place in places.items():
        if not place.exists():
            raise UsageError(
                f"{path}: its {name} {place.name} is not beside it", "put it into the same folder"
            )
    both = {f"filename_{name}": str(place) for name, place in places.items()}
    problem_file = here.with_name(f"{asked}{SUFFIX}")
    if not problem_file.exists():
        return reader(**both).open_map_dynamic(), problems([])
    scenario, planning_problems, _ = reader(**both, filename_scenario=str(problem_file)).open_all()
    return scenario, planning_problems


def _parse(path: str) -> tuple[str, Any]:
    data = Path(path).read_bytes()
    for kind in ("dynamic", "map", "scenario"):
        module = import_module(f"commonroad.common.protobuf.{kind}.commonroad_{kind}_pb2")
        message = getattr(module, f"CommonRoad{kind.capitalize()}")()
        try:
            message.ParseFromString(data)
        except import_module("google.protobuf.message").DecodeError:
            continue
        if data and message.IsInitialized():
            return kind, message
    if _OLDER in data[:_HEADER]:
        text = f"{path}: protobuf of format 2020a, in which map and obstacles are one file"
        raise UsageError(text, "read it with commonroad-io 2023, write it as XML, and give that")
    raise UsageError(f"{path}: not a CommonRoad scenario: neither map, dynamic nor scenario of format 2024")
