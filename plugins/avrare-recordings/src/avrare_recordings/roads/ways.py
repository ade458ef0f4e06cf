"""Ways through an intersection: which has priority, and where two of them meet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from avrare.driving import Crossing
from avrare.driving.reference_line import PolygonalLine, ReferenceLine
from avrare.protocols import Floats
from avrare_recordings.roads.lanelet_road import is_inside

Reason = Literal["right", "sign", "oncoming"]


@dataclass(frozen=True, eq=False)
class Way:
    """Lane through an intersection, which follows an incoming one.

    Attributes:
        name: Number of the lane.
        left: (K, 2) points of its left border [m].
        right: (K, 2) points of its right border [m].
        rank: Rank by the sign of the incoming lane: 2 priority, 1 no sign, 0 yield, -1 stop.
        heading: Direction at the end of the incoming lane [rad].
        turn: ``left``, ``straight`` or ``right``; empty where it is not known.
        lights: Whether traffic lights are in force at the incoming lane.
    """

    name: int
    left: Floats
    right: Floats
    rank: int
    heading: float
    turn: str
    lights: bool = False

    @property
    def line(self) -> PolygonalLine:
        """Its middle."""
        return PolygonalLine(0.5 * (self.left + self.right))

    @property
    def half_width(self) -> float:
        """Half of its median width [m]."""
        return 0.5 * float(np.median(np.hypot(*(self.left - self.right).T)))


def prefer(way: Way, other: Way) -> Reason | None:
    """Return why another way has priority over ``way``, None if it has not.

    Lights put signs and right before left out of force.
    """
    turned = math.remainder(other.heading - way.heading, 2.0 * math.pi)
    against = abs(turned) > 0.75 * math.pi
    if other.rank > way.rank and not way.lights:
        return "sign"
    if other.rank < way.rank and not way.lights:
        return None
    if against:
        return "oncoming" if way.turn == "left" and other.turn in ("straight", "right") else None
    return "right" if 0.25 * math.pi < turned and not way.lights else None


def find_crossing(line: ReferenceLine, ego_way: Way, other: Way) -> Crossing | None:
    """Return the conflict area of the ego's way, by stations on ``line``, and a way that has priority.

    None where the two do not overlap, or the other has no priority.
    """
    reason = prefer(ego_way, other)
    if reason is None or other.name == ego_way.name:
        return None
    points = _list_points(ego_way)
    common = points[is_inside(np.concatenate([other.left, other.right[::-1]]), points)]
    if not len(common):
        return None
    way = other.line
    x, stations = line.to_road(*common.T)[0], way.to_road(*common.T)[0]
    return Crossing(reason, *_range(x), way, *_range(stations), other.half_width)


def _range(values: Floats) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def _list_points(way: Way) -> Floats:
    # points inside a way, a grid length apart or less
    left, right = way.left, way.right
    length = max(np.hypot(*np.diff(side, axis=0).T).sum() for side in (left, right))
    grid = 0.25  # distance of the points by which a conflict area is found [m]
    share = np.linspace(0.0, len(left) - 1.0, max(2, len(left), int(length / grid) + 1))
    rows = [
        np.stack([np.interp(share, np.arange(len(side)), side[:, i]) for i in (0, 1)], axis=1)
        for side in (left, right)
    ]
    across = max(2, int(np.hypot(*(left - right).T).max() / grid) + 1)
    weights = (np.arange(across) + 0.5)[:, None, None] / across
    return np.asarray((weights * rows[0] + (1.0 - weights) * rows[1]).reshape(-1, 2))
