"""Straight parallel lanes: as written on the command line, or from the lanelets of a CommonRoad file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.driving import Road
from avrare.errors import UsageError
from avrare.protocols import Floats

_BEND = 0.3
"""A lane's centre line may leave the straight by this much [m]; lane widths may differ by as much."""
_SAME = 0.5
"""Centre lines nearer than this [m] belong to one lane."""

_LANES = "for example --lanes=-1.75,1.75,5.25 (y to the left, in metres)"
_HINT = "only one-way roads with straight, parallel lanes can be scored; or give --lanes"


@dataclass(frozen=True)
class Lanes:
    """A road and how it lies.

    Attributes:
        road: In its own frame, x along the lanes.
        angle: Direction of the lanes in the frame of the file [rad].
    """

    road: Road
    angle: float


@dataclass(frozen=True)
class _Strip:
    """A lanelet in the road's frame: id, centre y and width [m], begin and end x [m], its kind."""

    name: int
    y: float
    width: float
    begin: float
    end: float
    bend: float
    ramp: bool


def parse_road(centres: str, width: float, ramp: str | None = None) -> Road:
    """The road that ``--lanes -1.75,1.75,5.25 --lane-width 3.5 --access-ramp 0`` describes.

    Raises:
        UsageError: The words are no ascending numbers, or the ramp is none of the lanes.
    """
    try:
        lanes = tuple(float(word) for word in centres.split(","))
    except ValueError:
        raise UsageError(f"--lanes should be numbers with commas between, not {centres!r}", _LANES) from None
    if not all(map(math.isfinite, lanes)) or list(lanes) != sorted(set(lanes)):
        raise UsageError(f"--lanes should go from right to left, not {centres!r}", _LANES)
    if not (math.isfinite(width) and width > 0.0):
        raise UsageError(f"--lane-width should be above zero, not {width:g}")
    words = [] if ramp is None else [word.strip() for word in ramp.split(",")]
    if not all(word.isdecimal() and int(word) < len(lanes) for word in words):
        raise UsageError(f"--access-ramp should name lanes 0 to {len(lanes) - 1}, not {ramp!r}")
    return Road(lanes, width, tuple(map(int, words)))


def straight_lanes(path: str, lanelets: Sequence[Any]) -> Lanes:
    """The lanes along the longest lanelet.

    Lanelets that lead from one lane to another beside straight ones (the taper of a ramp) are no lanes of
    their own.

    Raises:
        UsageError: There is no road, or it is curved, or some lanes run against the others.
    """
    if not lanelets:
        raise UsageError(f"{path}: there are no lanelets", "give --lanes")
    longest = max((lanelet.center_vertices for lanelet in lanelets), key=_extent)
    chord = longest[-1] - longest[0]
    angle = math.atan2(chord[1], chord[0])
    strips = [_strip(lanelet, angle) for lanelet in lanelets]
    straight = [strip for strip in strips if strip.bend <= _BEND]
    for strip in strips:
        if strip.end < strip.begin:
            raise UsageError(f"{path}: lanelet {strip.name} runs against the others", _HINT)
        if strip.bend > _BEND and not _beside(strip, straight):
            raise UsageError(f"{path}: lanelet {strip.name} is curved", _HINT)
    return Lanes(_road(path, straight), angle)


def rotate(points: Floats, angle: float) -> Floats:
    """Points (..., 2) turned by ``-angle`` [rad] about the origin."""
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def _extent(vertices: Floats) -> float:
    return float(np.hypot(*(vertices[-1] - vertices[0])))


def _strip(lanelet: Any, angle: float) -> _Strip:
    centre, left, right = (
        rotate(np.asarray(vertices), angle)
        for vertices in (lanelet.center_vertices, lanelet.left_vertices, lanelet.right_vertices)
    )
    y = float(np.median(centre[:, 1]))
    kinds = {str(kind.value) for kind in lanelet.lanelet_type or ()}
    return _Strip(
        lanelet.lanelet_id,
        y,
        float(np.median(np.hypot(*(left - right).T))),
        float(centre[0, 0]),
        float(centre[-1, 0]),
        float(np.abs(centre[:, 1] - y).max()),
        "accessRamp" in kinds,
    )


def _beside(strip: _Strip, straight: Sequence[_Strip]) -> bool:
    """Whether straight lanelets cover the strip's whole stretch of road."""
    reached = strip.begin
    for other in sorted(straight, key=lambda other: other.begin):
        if other.begin <= reached + _SAME:
            reached = max(reached, other.end)
    return reached >= strip.end - _SAME


def _road(path: str, strips: Sequence[_Strip]) -> Road:
    lanes: list[list[_Strip]] = []
    for strip in sorted(strips, key=lambda strip: strip.y):
        if lanes and strip.y - lanes[-1][-1].y < _SAME:
            lanes[-1].append(strip)
        else:
            lanes.append([strip])
    widths = [strip.width for strip in strips]
    if max(widths) - min(widths) > _BEND:
        text = f"the lanes are {min(widths):.2f} to {max(widths):.2f} m wide"
        raise UsageError(
            f"{path}: {text}", "only roads with lanes of one width can be scored; or give --lanes"
        )
    return Road(
        tuple(round(float(np.mean([strip.y for strip in lane])), 6) for lane in lanes),
        round(float(np.mean(widths)), 6),
        tuple(index for index, lane in enumerate(lanes) if any(strip.ramp for strip in lane)),
        min(strip.begin for strip in strips),
        max(strip.end for strip in strips),
    )
