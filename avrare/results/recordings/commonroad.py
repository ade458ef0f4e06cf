"""Recordings in CommonRoad XML files: read with the package ``commonroad-io``, written without it.

Files are written in format 2020a. The road becomes one straight lanelet for each lane, and every vehicle a
moving obstacle: the ego has id 1, the others 2, 3, ... in the order of the scene.
"""

from __future__ import annotations

import importlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import PluginError, UsageError
from avrare.base.visible_text import escape_xml
from avrare.driving import Road
from avrare.driving.reference_line import ReferenceLine
from avrare.protocols import Floats
from avrare.results.recordings.lanelet_road import ASIDE, find_road, is_broad
from avrare.results.recordings.recording import FIELDS, Recording, VehicleTrack, assemble_recording

_EGO_ID = 1
_FIRST_LANELET_ID = 1001
_MARGIN = 50.0  # length of the lanelets beyond the vehicles [m]
_MAX_BEND = 0.3  # largest deviation of a centre line from straight, and of lane widths from each other [m]
_LANE_TOLERANCE = 0.5  # centre lines nearer than this belong to one lane [m]

_ROAD_HINT = "these are not straight, parallel lanes of one direction"


@dataclass(frozen=True)
class _LaneSegment:
    # a lanelet in the frame of the road
    name: int
    y: float
    width: float
    begin: float
    end: float
    bend: float
    crosses: bool  # it does not run along the road
    ramp: bool
    shoulder: bool
    broad: tuple[bool, bool]  # its left and its right marking


def read_commonroad(path: str, ego: str | None, road: Road | None = None) -> Recording:
    """Read the obstacles of a scenario as vehicles, one of them as the ego.

    The lanes are those of the lanelets: all of them where they are straight and parallel, else those along
    the ego's way, in whose frame the vehicles then are; or ``road``, in the frame of the file. Rules apply
    to the obstacle with the id ``ego``. Accelerations are differences of speed.
    """
    return open_commonroad(path, road).recording(ego)


def open_commonroad(path: str, road: Road | None = None) -> CommonRoadDrives:
    """Read a scenario once, for any number of egos."""
    scenario = _open_scenario(path)
    obstacles = {str(one.obstacle_id): _read_obstacle(path, one) for one in scenario.obstacles}
    moving = tuple(sorted((str(one.obstacle_id) for one in scenario.dynamic_obstacles), key=int))
    return CommonRoadDrives(
        path, float(scenario.dt), obstacles, moving, tuple(scenario.lanelet_network.lanelets), road
    )


@dataclass(frozen=True)
class CommonRoadDrives:
    """Scenario in whose traffic any moving obstacle can be the ego.

    Attributes:
        path: File.
        dt: Step [s].
        obstacles: Obstacles by name, in the plane.
        names: The moving ones.
        lanelets: The network.
        road: The caller's own road, or None.
    """

    path: str
    dt: float
    obstacles: Mapping[str, Obstacle]
    names: tuple[str, ...]
    lanelets: tuple[Any, ...]
    road: Road | None = None

    def recording(self, ego: str | None) -> Recording:
        """Return the drive of one ego; UsageError if it is not there, has gaps, or is on no road."""
        if ego not in self.names:
            known = ", ".join(self.names) or "none"
            text = "no ego is chosen" if ego is None else f"there is no moving obstacle {ego!r}"
            raise UsageError(f"{self.path}: {text}", f"choose it with --ego; there are: {known}")
        own = self.obstacles[ego]
        first, samples = int(own.steps.min()), int(own.steps.max() - own.steps.min()) + 1
        if len(set(own.steps.tolist())) < samples:  # or else one step far off makes arrays of any size
            raise UsageError(
                f"{self.path}: obstacle {ego} has gaps in time", "the ego needs a state at every step"
            )
        road, angle = self._find_road(own)
        tracks = {name: one.track(first, samples, angle, road.line) for name, one in self.obstacles.items()}
        if not tracks[ego].present.all():
            at = first + int(np.argmin(tracks[ego].present))
            text = f"{self.path}: obstacle {ego} leaves the road at step {at}"
            raise UsageError(text, f"it is more than {ASIDE:g} m from the line along its lanes")
        others = [track for name, track in tracks.items() if name != ego and track.present.any()]
        return assemble_recording(self.path, self.dt, self.dt * first, tracks[ego], others, road)

    def _find_road(self, ego: Obstacle) -> tuple[Road, float]:
        if self.road is not None:
            return self.road, 0.0
        if self._straight is not None:
            return self._straight
        return find_road(self.path, self.lanelets, ego.states[:2].T, ego.states[2]), 0.0

    @cached_property
    def _straight(self) -> tuple[Road, float] | None:
        if not self.lanelets:
            raise UsageError(f"{self.path}: there are no lanelets", "give --lanes")
        try:
            return find_straight_lanes(self.path, self.lanelets)
        except UsageError:
            return None


@dataclass(frozen=True)
class Obstacle:
    """Obstacle over time, in the plane.

    Attributes:
        name: Its id.
        length: [m].
        width: [m].
        steps: (K,) steps at which it is known; empty: it stands there all the time.
        states: (4, K), or (4, 1): x, y [m], heading [rad], speed [m/s].
    """

    name: str
    length: float
    width: float
    steps: NDArray[np.int64]
    states: Floats

    def track(self, first: int, samples: int, angle: float, line: ReferenceLine | None) -> VehicleTrack:
        """Return it from step ``first`` on, in the frame of a line, or turned by ``-angle``."""
        present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
        x, y = _rotate(self.states[:2].T, angle).T
        if line is None:
            turned = np.array([math.remainder(h - angle, 2.0 * math.pi) for h in self.states[2]])
        else:
            x, y = line.to_road(x, y)
            turned = np.remainder(self.states[2] - line.heading(x) + math.pi, 2.0 * math.pi) - math.pi
        known = np.isfinite(x) & ((np.abs(y) <= ASIDE) | (line is None))
        rows = np.stack([x, y, turned, self.states[3]])
        if not len(self.steps):
            present[:] = known[0]
            states[:4], states[4] = rows[:, [0]], 0.0
        else:
            at = self.steps - first
            kept = known & (at >= 0) & (at < samples)
            present[at[kept]] = True
            states[:4, at[kept]] = rows[:, kept]
        return VehicleTrack(self.name, self.length, self.width, present, states)


def to_commonroad(recording: Recording, name: str) -> str:
    """Return the XML text of a recording with a road, as a scenario with this name."""
    scene = recording.scene
    if scene is None:
        text = f"{recording.source}: a CommonRoad file needs vehicles and a road"
        raise UsageError(text, "use --csv instead")
    root = ET.Element(
        "commonRoad", timeStepSize=repr(recording.dt), commonRoadVersion="2020a", author="avrare",
        affiliation="", source=escape_xml(name), benchmarkID="ZAM_Failure-1_1_T-1", date="2000-01-01",
    )  # fmt: skip
    location = ET.SubElement(root, "location")
    _add_texts(location, geoNameId="-999", gpsLatitude="999", gpsLongitude="999")
    ET.SubElement(ET.SubElement(root, "scenarioTags"), "interstate")
    states = {_EGO_ID: np.stack([recording.signals[f"ego_{field}"] for field in FIELDS], axis=1)}
    others = np.stack([recording.signals[f"others_{field}"] for field in FIELDS], axis=2)
    states |= {_EGO_ID + 1 + v: others[:, v] for v in range(len(scene.names))}
    sizes = [(scene.ego_length, scene.ego_width), *zip(scene.lengths, scene.widths, strict=True)]
    reach = np.concatenate([track[:, 0] for track in states.values()])
    begin, end = min(scene.road.begin, reach.min()), max(scene.road.end, reach.max())
    _add_lanelets(root, scene.road, begin - _MARGIN, end + _MARGIN)
    for (number, track), (length, width) in zip(states.items(), sizes, strict=True):
        _add_obstacle(root, number, float(length), float(width), track)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _open_scenario(path: str) -> Any:
    try:
        reader = importlib.import_module("commonroad.common.file_reader")
    except ImportError as error:
        text = f"{path}: CommonRoad files need the package commonroad-io"
        raise PluginError(text, "pip install 'avrare[commonroad]'") from error
    try:
        open(path, "rb").close()
        scenario, _ = reader.CommonRoadFileReader(path).open()
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file") from None
    except Exception as error:  # the reader raises whatever its XML parser or its assertions raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"{path}: not a CommonRoad scenario: {reason[:200]}") from None
    return scenario


def _list_states(path: str, obstacle: Any) -> list[Any]:
    prediction = getattr(obstacle, "prediction", None)
    if prediction is None:
        return [obstacle.initial_state]
    if not hasattr(prediction, "trajectory"):
        text = f"{path}: obstacle {obstacle.obstacle_id} has no trajectory"
        raise UsageError(text, "sets are not supported")
    return [obstacle.initial_state, *prediction.trajectory.state_list]


def _read_obstacle(path: str, obstacle: Any) -> Obstacle:
    length, width = _read_size(path, obstacle)
    static = str(obstacle.obstacle_role.value) == "static"
    states = [obstacle.initial_state] if static else _list_states(path, obstacle)
    poses = np.array([_read_pose(path, obstacle, state) for state in states]).T
    steps = [] if static else [int(state.time_step) for state in states]
    return Obstacle(str(obstacle.obstacle_id), length, width, np.array(steps, dtype=np.int64), poses)


def _read_pose(path: str, obstacle: Any, state: Any) -> list[float]:
    values: list[Any] = [getattr(state, name, None) for name in ("position", "orientation", "velocity")]
    position, heading, speed = values
    if str(obstacle.obstacle_role.value) == "static":
        speed = 0.0
    if not isinstance(position, np.ndarray) or not _is_number(heading) or not _is_number(speed):
        text = f"obstacle {obstacle.obstacle_id} has no exact position, orientation and velocity"
        raise UsageError(f"{path}: {text} at step {state.time_step}")
    return [float(position[0]), float(position[1]), float(heading), float(speed)]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def _read_size(path: str, obstacle: Any) -> tuple[float, float]:
    shape = obstacle.obstacle_shape
    if hasattr(shape, "length") and hasattr(shape, "width"):
        return float(shape.length), float(shape.width)
    if hasattr(shape, "radius"):  # a circle counts as the square around it
        return 2.0 * float(shape.radius), 2.0 * float(shape.radius)
    text = f"{path}: obstacle {obstacle.obstacle_id} is a {type(shape).__name__}"
    raise UsageError(text, "only rectangles and circles have a size")


def _add_lanelets(root: ET.Element, road: Road, begin: float, end: float) -> None:
    half = 0.5 * road.lane_width
    for lane, centre in enumerate(road.lane_centres):
        lanelet = ET.SubElement(root, "lanelet", id=str(_FIRST_LANELET_ID + lane))
        for side, y in (("leftBound", centre + half), ("rightBound", centre - half)):
            bound = ET.SubElement(lanelet, side)
            for x in (begin, end):
                _add_point(bound, x, y)
        for side, neighbour in (("adjacentLeft", lane + 1), ("adjacentRight", lane - 1)):
            if 0 <= neighbour < len(road.lane_centres):
                ET.SubElement(lanelet, side, ref=str(_FIRST_LANELET_ID + neighbour), drivingDir="same")
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


def find_straight_lanes(path: str, lanelets: Sequence[Any]) -> tuple[Road, float]:
    """Return the lanes parallel to the longest lanelet, with x along them, and the direction of x [rad].

    Curved lanelets beside straight ones, such as the taper of a ramp, are ignored.
    """
    if not lanelets:
        raise UsageError(f"{path}: there are no lanelets", "give --lanes")
    chords = (lanelet.center_vertices[-1] - lanelet.center_vertices[0] for lanelet in lanelets)
    chord = max(chords, key=lambda one: float(np.hypot(*one)))
    angle = math.atan2(chord[1], chord[0])
    segments = [_make_segment(lanelet, angle) for lanelet in lanelets]
    straight = [segment for segment in segments if segment.bend <= _MAX_BEND]
    for segment in segments:
        if segment.end < segment.begin:
            raise UsageError(f"{path}: lanelet {segment.name} runs against the others", _ROAD_HINT)
        if segment.bend > _MAX_BEND and (segment.crosses or not _is_covered(segment, straight)):
            raise UsageError(f"{path}: lanelet {segment.name} is curved", _ROAD_HINT)
    return _join_segments(path, straight), angle


def _rotate(points: Floats, angle: float) -> Floats:
    # points (..., 2) by ``-angle`` [rad] about the origin
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def _make_segment(lanelet: Any, angle: float) -> _LaneSegment:
    lines = (lanelet.center_vertices, lanelet.left_vertices, lanelet.right_vertices)
    centre, left, right = (_rotate(np.asarray(line), angle) for line in lines)
    y = float(np.median(centre[:, 1]))
    kinds = {str(kind.value) for kind in lanelet.lanelet_type or ()}
    return _LaneSegment(
        lanelet.lanelet_id,
        y,
        float(np.median(np.hypot(*(left - right).T))),
        float(centre[0, 0]),
        float(centre[-1, 0]),
        float(np.abs(centre[:, 1] - y).max()),
        bool(np.ptp(centre[:, 0]) < np.ptp(centre[:, 1])),
        "accessRamp" in kinds,
        "shoulder" in kinds,
        (is_broad(lanelet, "left"), is_broad(lanelet, "right")),
    )


def _is_covered(segment: _LaneSegment, straight: Sequence[_LaneSegment]) -> bool:
    reached = segment.begin
    for other in sorted(straight, key=lambda other: other.begin):
        if other.begin <= reached + _LANE_TOLERANCE:
            reached = max(reached, other.end)
    return reached >= segment.end - _LANE_TOLERANCE


def _join_segments(path: str, segments: Sequence[_LaneSegment]) -> Road:
    lanes: list[list[_LaneSegment]] = []
    for segment in sorted(segments, key=lambda segment: segment.y):
        if lanes and segment.y - lanes[-1][-1].y < _LANE_TOLERANCE:
            lanes[-1].append(segment)
        else:
            lanes.append([segment])
    widths = [segment.width for segment in segments]
    if max(widths) - min(widths) > _MAX_BEND:
        raise UsageError(f"{path}: the lanes are {min(widths):.2f} to {max(widths):.2f} m wide", _ROAD_HINT)
    return Road(
        tuple(round(float(np.mean([segment.y for segment in lane])), 6) for lane in lanes),
        round(float(np.mean(widths)), 6),
        tuple(index for index, lane in enumerate(lanes) if any(segment.ramp for segment in lane)),
        min(segment.begin for segment in segments),
        max(segment.end for segment in segments),
        shoulder=tuple(index for index, lane in enumerate(lanes) if any(one.shoulder for one in lane)),
        broad_markings=tuple(
            index
            for index, lane in enumerate(lanes)
            if any(one.broad[0] for one in lane) or any(one.broad[1] for one in _after(lanes, index))
        ),
    )


def _after(lanes: Sequence[Sequence[_LaneSegment]], index: int) -> Sequence[_LaneSegment]:
    return lanes[index + 1] if index + 1 < len(lanes) else ()
