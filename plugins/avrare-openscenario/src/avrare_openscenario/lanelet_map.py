"""Road of a CommonRoad file, for scenarios that name one in place of an OpenDRIVE file.

The reference line follows the way of lanelets with the most points; its lanes are named by the ids of their
lanelets, and the road by ``0``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.protocols import Floats
from avrare_openscenario.network import Network, RoadMap
from avrare_openscenario.xml_tree import Element
from avrare_recordings.formats.commonroad import read_lanelets
from avrare_recordings.roads.lanelet_road import find_road
from avrare_single_track.recorded import has_constant_lanes

if TYPE_CHECKING:
    from commonroad.scenario.lanelet import Lanelet

_REACH = 1.0
"""What a lane may lack at either end of the road [m]."""


def is_lanelet_map(path: str) -> bool:
    """Return whether a file is one of CommonRoad, by its suffix or its first element."""
    if path.lower().endswith(".pb"):
        return True
    try:
        with open(path, "rb") as file:
            head_bytes = 4096
            return b"<commonRoad" in file.read(head_bytes)
    except (OSError, ValueError):
        return False  # the reader of the other format says what is wrong


def read_lanelet_map(path: str, named: Element) -> Network:
    """Read the road of a file.

    Raises:
        UsageError: The lanes begin, end, or change their widths, or are no lanes of one road.
    """
    try:
        lanelets = read_lanelets(path)
        road = find_road(path, lanelets, *_middles(lanelets)) if lanelets else None
    except UsageError as error:
        raise named.error(error.message, error.hint) from None
    if road is None:
        raise named.error(f"{path} has no lanelets")
    line = road.line
    assert line is not None
    _check(named, path, road, line.length)
    places = ((int(lanelet.lanelet_id), _lane_of(road, lanelet)) for lanelet in lanelets)
    indices = {name: lane for name, lane in places if lane is not None}
    centres = {name: road.lane_centres[lane] for name, lane in indices.items()}
    road_id = "0"
    return Network((RoadMap(road, line, {road_id: 0.0}, indices, centres),))


def _middles(lanelets: Sequence[Lanelet]) -> tuple[Floats, Floats]:
    # Points all over the network, in the directions of its lanelets.
    points, headings = [], []
    for lanelet in lanelets:
        centre = np.asarray(lanelet.center_vertices)[:, :2]
        steps = np.diff(centre, axis=0)
        points.append(0.5 * (centre[1:] + centre[:-1]))
        headings.append(np.arctan2(steps[:, 1], steps[:, 0]))
    return np.concatenate(points), np.concatenate(headings)


def _check(named: Element, path: str, road: Road, length: float) -> None:
    if not has_constant_lanes(road):
        raise named.error(f"the lanes of {path} change their widths", "only constant widths are read")
    for lane in road.lanes:
        if lane.stations[0] > _REACH or lane.stations[-1] < length - _REACH:
            raise named.error(f"lanes of {path} begin or end", "only lanes as long as the road are read")


def _lane_of(road: Road, lanelet: Lanelet) -> int | None:
    # Lane in whose middle a lanelet lies from end to end; one that crosses it does at one point only.
    assert road.line is not None
    _, y = road.line.to_road(*np.asarray(lanelet.center_vertices)[:, :2].T)
    apart = np.abs(np.array(road.lane_centres)[:, None] - y).max(axis=1)
    nearest = int(apart.argmin()) if np.isfinite(apart).all() else -1
    return nearest if nearest >= 0 and apart[nearest] < 0.25 * road.lane_width else None
