"""Recordings in CommonRoad files: read with the package ``commonroad-io``, written without it.

XML of 2020a and the protobuf files of 2024 are read, format 2020a is written: the road as one straight
lanelet for each lane, every vehicle as a moving obstacle, the ego with id 1, the others 2, 3, ...
in the order of the scene.
"""

from __future__ import annotations

import functools
import importlib
import logging
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from avrare.base.errors import PluginError, UsageError
from avrare.base.visible_text import escape_xml
from avrare.driving import Road
from avrare.protocols import Floats
from avrare.results.recordings import FIELDS, Recording
from avrare_recordings.formats.commonroad_2024 import SUFFIX, open_2024
from avrare_recordings.roads.crossings import check_references
from avrare_recordings.roads.plane_drives import Obstacle, PlaneDrives

if TYPE_CHECKING:
    from commonroad.planning.planning_problem import PlanningProblemSet
    from commonroad.scenario.lanelet import Lanelet, LaneletNetwork
    from commonroad.scenario.obstacle import Obstacle as RecordedObstacle
    from commonroad.scenario.scenario import Scenario
    from commonroad.scenario.state import State


def read_commonroad(path: str, ego: str | None, road: Road | None = None) -> Recording:
    """Read the obstacles of a scenario as vehicles, one of them as the ego.

    The lanes are those of the lanelets: all of them where they are straight and parallel, else those along
    the ego's way, in whose frame the vehicles then are; or where these cannot be read ``road``, in the frame
    of the file. Rules apply to the obstacle with the id ``ego``. Accelerations are differences of speed.
    """
    return open_commonroad(path, road).recording(ego)


def open_commonroad(path: str, road: Road | None = None) -> PlaneDrives:
    """Read a scenario once, for any number of egos."""
    return _read_drives(path, _open_scenario(path), road)


def open_problem(path: str, number: int | None = None) -> tuple[PlaneDrives, Obstacle]:
    """Read a scenario and the start of a planning problem, as an obstacle at one step.

    Raises:
        UsageError: The problem does not exist, or several do and none is chosen, or its start is not
            exact.
    """
    scenario, problems = _open_file(path)
    numbers = dict(problems.planning_problem_dict)
    if number is None and len(numbers) == 1:
        (number,) = numbers
    if number not in numbers:
        text = "no planning problem is chosen" if number is None else f"there is no planning problem {number}"
        names = ", ".join(map(str, sorted(numbers))) or "none"
        raise UsageError(f"{path}: {text}", f"choose it with `problem`; there are: {names}")
    state = numbers[number].initial_state
    pose = np.array([_read_pose(path, f"planning problem {number}", state)]).T
    start = Obstacle(str(number), 0.0, 0.0, np.array([int(state.time_step)]), pose)
    return _read_drives(path, scenario, None), start


def _read_drives(path: str, scenario: Scenario, road: Road | None) -> PlaneDrives:
    recorded = (*scenario.static_obstacles, *scenario.dynamic_obstacles)
    obstacles = {str(obstacle.obstacle_id): _read_obstacle(path, obstacle) for obstacle in recorded}
    moving = tuple(sorted((name for name, obstacle in obstacles.items() if len(obstacle.steps)), key=int))
    network = scenario.lanelet_network
    return PlaneDrives(path, float(scenario.dt), obstacles, moving, tuple(network.lanelets), road, network)


def read_lanelets(path: str) -> tuple[Lanelet, ...]:
    """Return the lanelets of a scenario or map."""
    return tuple(_open_scenario(path).lanelet_network.lanelets)


def read_network(path: str) -> tuple[LaneletNetwork, float]:
    """Return the lanelet network of a scenario or map, and the step of its light cycles [s]."""
    scenario = _open_scenario(path)
    check_references(path, scenario.lanelet_network)
    return scenario.lanelet_network, float(scenario.dt)


def to_commonroad(recording: Recording, name: str) -> str:
    """Return the XML text of a recording with a road, as a scenario with this name."""
    scene = recording.scene
    if scene is None:
        text = f"{recording.source}: a CommonRoad file needs vehicles and a road"
        raise UsageError(text, "write a .csv file instead")
    if scene.road.line is not None or scene.road.lanes:
        text = f"{recording.source}: only straight roads are written as CommonRoad files"
        raise UsageError(text, "write a .csv file instead")
    root = ET.Element(
        "commonRoad",
        timeStepSize=repr(recording.dt),
        commonRoadVersion="2020a",
        author="avrare",
        affiliation="",
        source=escape_xml(name),
        benchmarkID="ZAM_Failure-1_1_T-1",
        date="2000-01-01",
    )
    location = ET.SubElement(root, "location")
    _add_texts(location, geoNameId="-999", gpsLatitude="999", gpsLongitude="999")
    ET.SubElement(ET.SubElement(root, "scenarioTags"), "interstate")
    ego_id = 1
    states = {ego_id: np.stack([recording.signals[f"ego_{field}"] for field in FIELDS], axis=1)}
    others = np.stack([recording.signals[f"others_{field}"] for field in FIELDS], axis=2)
    states |= {ego_id + 1 + v: others[:, v] for v in range(len(scene.names))}
    sizes = [(scene.ego_length, scene.ego_width), *zip(scene.lengths, scene.widths, strict=True)]
    reach = np.concatenate([track[:, 0] for track in states.values()])
    begin, end = min(scene.road.begin, reach.min()), max(scene.road.end, reach.max())
    margin = 50.0  # of the lanelets beyond the vehicles [m]
    _add_lanelets(root, scene.road, begin - margin, end + margin)
    for (number, track), (length, width) in zip(states.items(), sizes, strict=True):
        _add_obstacle(root, number, float(length), float(width), track)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _open_scenario(path: str) -> Scenario:
    return _open_file(path)[0]


def _open_file(path: str) -> tuple[Scenario, PlanningProblemSet]:
    try:
        reader = importlib.import_module("commonroad.common.file_reader")
    except ImportError as error:
        text = f"{path}: CommonRoad files need the package commonroad-io"
        raise PluginError(text, "pip install 'avrare-recordings[commonroad]'") from error
    try:
        open(path, "rb").close()
        with _warn_once_of_old_elements(path):
            if path.lower().endswith(SUFFIX):
                return open_2024(path)
            scenario, problems = reader.CommonRoadFileReader(path).open()
    except UsageError:
        raise
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file") from None
    except Exception as error:  # the reader raises whatever its XML parser or its assertions raise
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, (AttributeError, IndexError, KeyError, TypeError)):
            reason = f"an element or attribute that its reader needs is missing ({reason})"
        raise UsageError(f"{path}: not a CommonRoad scenario: {reason[:200]}") from None
    return scenario, problems


class _Keep(logging.Handler):
    def __init__(self, texts: list[str]) -> None:
        super().__init__()
        self.texts = texts

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


@contextmanager
def _warn_once_of_old_elements(path: str) -> Iterator[None]:
    # commonroad-io has a line for each old element of a file.
    texts: list[str] = []
    logger, keep = logging.getLogger("commonroad"), _Keep(texts)
    logger.addHandler(keep)
    logger.propagate = False
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
    finally:
        logger.removeHandler(keep)
        logger.propagate = True
    texts += [str(warning.message) for warning in caught]
    if texts:
        more = f", and {len(texts) - 1:,} more of this kind" if len(texts) > 1 else ""
        warn_once(f"{path}: {' '.join(texts[0].split())}{more}")


@functools.cache
def warn_once(text: str) -> None:
    """Print on stderr how a file is read, each sentence once."""
    logging.getLogger(__name__).warning(text)


def _read_obstacle(path: str, obstacle: RecordedObstacle) -> Obstacle:
    # Without a trajectory of points, as where its future is a set, it stands where it starts.
    length, width = _read_size(path, obstacle)
    trajectory = getattr(getattr(obstacle, "prediction", None), "trajectory", None)
    later = [] if trajectory is None else trajectory.state_list
    static = not later or not all(isinstance(state.position, np.ndarray) for state in later)
    states = [obstacle.initial_state, *([] if static else later)]
    if static and str(obstacle.obstacle_role.value) != "static":
        text = f"{path}: obstacle {obstacle.obstacle_id} has no trajectory of points"
        warn_once(f"{text}: it stands where it starts")
    name = f"obstacle {obstacle.obstacle_id}"
    poses = np.array([_read_pose(path, name, state, static) for state in states]).T
    steps = [] if static else [int(state.time_step) for state in states]
    return Obstacle(str(obstacle.obstacle_id), length, width, np.array(steps, dtype=np.int64), poses)


def _read_pose(path: str, name: str, state: State, static: bool = False) -> list[float]:
    values: list[Any] = [getattr(state, field, None) for field in ("position", "orientation", "velocity")]
    position, heading, speed = values
    if static:
        speed = 0.0
    exact = isinstance(position, np.ndarray) and bool(np.isfinite(position).all())
    if not exact or not _is_number(heading) or not _is_number(speed):
        text = f"{name} has no exact position, orientation and velocity at step {state.time_step}"
        raise UsageError(f"{path}: {text}")
    if not static and not _is_number(state.time_step):
        raise UsageError(f"{path}: {name} has a state whose time is an interval", "only steps are supported")
    if not static and abs(state.time_step) >= 2**62:  # more than arrays of steps hold
        raise UsageError(f"{path}: {name} has a state at step {str(state.time_step)[:30]}")
    return [float(position[0]), float(position[1]), float(heading), float(speed)]


def _is_number(value: object) -> bool:
    largest = sys.float_info.max
    return isinstance(value, (int, float, np.number)) and bool(-largest <= value <= largest)


def _read_size(path: str, obstacle: RecordedObstacle) -> tuple[float, float]:
    shape = obstacle.obstacle_shape
    if hasattr(shape, "length") and hasattr(shape, "width"):
        return float(shape.length), float(shape.width)
    if hasattr(shape, "radius"):  # a circle counts as the square around it
        return 2.0 * float(shape.radius), 2.0 * float(shape.radius)
    text = f"{path}: obstacle {obstacle.obstacle_id} is a {type(shape).__name__}"
    raise UsageError(text, "only rectangles and circles have a size")


def _add_lanelets(root: ET.Element, road: Road, begin: float, end: float) -> None:
    half = 0.5 * road.lane_width
    first_id = 1001
    for lane, centre in enumerate(road.lane_centres):
        lanelet = ET.SubElement(root, "lanelet", id=str(first_id + lane))
        for side, y in (("leftBound", centre + half), ("rightBound", centre - half)):
            bound = ET.SubElement(lanelet, side)
            for x in (begin, end):
                _add_point(bound, x, y)
        for side, neighbour in (("adjacentLeft", lane + 1), ("adjacentRight", lane - 1)):
            if 0 <= neighbour < len(road.lane_centres):
                ET.SubElement(lanelet, side, ref=str(first_id + neighbour), drivingDir="same")
        _add_texts(lanelet, laneletType="accessRamp" if lane in road.access_ramp else "mainCarriageWay")


def _add_obstacle(root: ET.Element, number: int, length: float, width: float, states: Floats) -> None:
    obstacle = ET.SubElement(root, "dynamicObstacle", id=str(number))
    _add_texts(obstacle, type="car")
    rectangle = ET.SubElement(ET.SubElement(obstacle, "shape"), "rectangle")
    _add_texts(rectangle, length=repr(length), width=repr(width))
    _add_state(ET.SubElement(obstacle, "initialState"), 0, states[0])
    trajectory = ET.SubElement(obstacle, "trajectory")
    for step, state in enumerate(states[1:], start=1):
        _add_state(ET.SubElement(trajectory, "state"), step, state)


def _add_state(element: ET.Element, step: int, state: Floats) -> None:
    x, y, heading, speed, acceleration = map(float, state)
    _add_exact(element, time=str(step))
    _add_point(ET.SubElement(element, "position"), x, y)
    _add_exact(element, orientation=repr(heading), velocity=repr(speed), acceleration=repr(acceleration))
    if step == 0:
        _add_exact(element, yawRate="0.0", slipAngle="0.0")


def _add_exact(element: ET.Element, **values: str) -> None:
    for name, value in values.items():
        _add_texts(ET.SubElement(element, name), exact=value)


def _add_point(element: ET.Element, x: float, y: float) -> None:
    _add_texts(ET.SubElement(element, "point"), x=repr(float(x)), y=repr(float(y)))


def _add_texts(element: ET.Element, **texts: str) -> None:
    for name, text in texts.items():
        ET.SubElement(element, name).text = text
