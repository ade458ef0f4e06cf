"""A rollout as a CommonRoad scenario (format 2020a), written without any package for it.

The road becomes one straight lanelet a lane, and every vehicle a moving obstacle: the ego has id 1, the
others 2, 3, ... in the scene's order.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from avrare.driving import Road
from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.record.trace import FIELDS, Recording

EGO = 1
"""Id of the ego."""

_FIRST_LANELET = 1001
_SPARE = 50.0
"""The lanelets go on this far beyond the vehicles [m]."""


def to_commonroad(recording: Recording, name: str) -> str:
    """The XML text of a recording with a road.

    Args:
        recording: Of vehicles.
        name: Of the scenario, told in the file.

    Raises:
        UsageError: There is no road.
    """
    scene = recording.scene
    if scene is None:
        raise UsageError(f"{recording.source}: a CommonRoad file needs vehicles and a road", "take --csv")
    root = ET.Element(
        "commonRoad", timeStepSize=repr(recording.dt), commonRoadVersion="2020a", author="avrare",
        affiliation="", source=name, benchmarkID="ZAM_Failure-1_1_T-1", date="2000-01-01",
    )  # fmt: skip
    location = ET.SubElement(root, "location")
    for key, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        ET.SubElement(location, key).text = value
    ET.SubElement(ET.SubElement(root, "scenarioTags"), "interstate")
    states = {EGO: np.stack([recording.signals[f"ego_{field}"] for field in FIELDS], axis=1)}
    others = np.stack([recording.signals[f"others_{field}"] for field in FIELDS], axis=2)
    states |= {EGO + 1 + v: others[:, v] for v in range(len(scene.names))}
    sizes = [(scene.ego_length, scene.ego_width), *zip(scene.lengths, scene.widths, strict=True)]
    reach = np.concatenate([path[:, 0] for path in states.values()])
    _lanelets(
        root,
        scene.road,
        min(scene.road.begin, reach.min()) - _SPARE,
        max(scene.road.end, reach.max()) + _SPARE,
    )
    for (number, path), (length, width) in zip(states.items(), sizes, strict=True):
        _obstacle(root, number, float(length), float(width), path)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _lanelets(root: ET.Element, road: Road, begin: float, end: float) -> None:
    half = 0.5 * road.lane_width
    for lane, centre in enumerate(road.lane_centres):
        lanelet = ET.SubElement(root, "lanelet", id=str(_FIRST_LANELET + lane))
        for side, y in (("leftBound", centre + half), ("rightBound", centre - half)):
            bound = ET.SubElement(lanelet, side)
            for x in (begin, end):
                _point(bound, x, y)
        for side, neighbour in (("adjacentLeft", lane + 1), ("adjacentRight", lane - 1)):
            if 0 <= neighbour < len(road.lane_centres):
                ET.SubElement(lanelet, side, ref=str(_FIRST_LANELET + neighbour), drivingDir="same")
        kind = "accessRamp" if lane in road.access_ramp else "mainCarriageWay"
        ET.SubElement(lanelet, "laneletType").text = kind


def _obstacle(root: ET.Element, number: int, length: float, width: float, states: Floats) -> None:
    obstacle = ET.SubElement(root, "dynamicObstacle", id=str(number))
    ET.SubElement(obstacle, "type").text = "car"
    rectangle = ET.SubElement(ET.SubElement(obstacle, "shape"), "rectangle")
    ET.SubElement(rectangle, "length").text = repr(length)
    ET.SubElement(rectangle, "width").text = repr(width)
    _state(ET.SubElement(obstacle, "initialState"), 0, states[0])
    trajectory = ET.SubElement(obstacle, "trajectory")
    for step, state in enumerate(states[1:], start=1):
        _state(ET.SubElement(trajectory, "state"), step, state)


def _state(element: ET.Element, step: int, state: Floats) -> None:
    x, y, heading, speed, acceleration = map(float, state)
    _exact(element, "time", str(step))
    _point(ET.SubElement(element, "position"), x, y)
    _exact(element, "orientation", repr(heading))
    _exact(element, "velocity", repr(speed))
    _exact(element, "acceleration", repr(acceleration))
    if step == 0:
        _exact(element, "yawRate", "0.0")
        _exact(element, "slipAngle", "0.0")


def _exact(element: ET.Element, name: str, value: str) -> None:
    ET.SubElement(ET.SubElement(element, name), "exact").text = value


def _point(element: ET.Element, x: float, y: float) -> None:
    point = ET.SubElement(element, "point")
    ET.SubElement(point, "x").text = repr(float(x))
    ET.SubElement(point, "y").text = repr(float(y))
