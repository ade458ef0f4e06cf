"""Straight, parallel lanes of a lanelet network, in a frame turned along them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.protocols import Floats
from avrare_recordings.roads.lanelet_road import is_broad

if TYPE_CHECKING:
    from commonroad.scenario.lanelet import Lanelet

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


def find_straight_lanes(path: str, lanelets: Sequence[Lanelet]) -> tuple[Road, float]:
    """Return the lanes parallel to the longest lanelet, with x along them, and the direction of x [rad].

    Curved lanelets beside straight ones, such as the taper of a ramp, are ignored.
    """
    if not lanelets:
        raise UsageError(f"{path}: there are no lanelets", "give the lanes yourself")
    chords = (
        (lanelet.center_vertices[-1] - lanelet.center_vertices[0])[:2] for lanelet in lanelets
    )  # heights aside
    chord = max(chords, key=lambda lanelet: float(np.hypot(*lanelet)))
    angle = math.atan2(chord[1], chord[0])
    segments = [_make_segment(lanelet, angle) for lanelet in lanelets]
    straight = [segment for segment in segments if segment.bend <= _MAX_BEND]
    for segment in segments:
        if segment.end < segment.begin:
            raise UsageError(f"{path}: lanelet {segment.name} runs against the others", _ROAD_HINT)
        if segment.bend > _MAX_BEND and (segment.crosses or not _is_covered(segment, straight)):
            raise UsageError(f"{path}: lanelet {segment.name} is curved", _ROAD_HINT)
    return _join_segments(path, straight), angle


def rotate(points: Floats, angle: float) -> Floats:
    """Return points (..., 2) turned by ``-angle`` [rad] about the origin."""
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def _make_segment(lanelet: Lanelet, angle: float) -> _LaneSegment:
    lines = (lanelet.center_vertices, lanelet.left_vertices, lanelet.right_vertices)
    centre, left, right = (rotate(np.asarray(line), angle) for line in lines)
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
        shoulder=tuple(
            index for index, lane in enumerate(lanes) if any(section.shoulder for section in lane)
        ),
        broad_markings=tuple(
            index
            for index, lane in enumerate(lanes)
            if any(section.broad[0] for section in lane)
            or any(section.broad[1] for section in _after(lanes, index))
        ),
    )


def _after(lanes: Sequence[Sequence[_LaneSegment]], index: int) -> Sequence[_LaneSegment]:
    return lanes[index + 1] if index + 1 < len(lanes) else ()
