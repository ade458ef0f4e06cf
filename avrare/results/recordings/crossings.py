"""Intersections of a lanelet network on the way of one vehicle: its stop signs, and who has priority over it.

Only attributes of commonroad-io's networks are read. A way through an intersection is a lanelet that follows
an incoming one; the ego's is the one it drives on, so that its direction is observed, not guessed.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from avrare.driving import Crossing, Road
from avrare.driving.reference_line import PolygonalLine, ReferenceLine
from avrare.protocols import Floats
from avrare.results.recordings.lanelet_road import is_inside

_PRIORITY = {"PRIORITY": 2, "RIGHT_OF_WAY": 2, "YIELD": 0, "STOP": -1}
"""Rank of an incoming lanelet by its sign; 1 without one."""

_GRID = 0.25  # distance of the points by which a conflict area is found [m]

Reason = Literal["right", "sign", "oncoming"]


@dataclass(frozen=True)
class _Way:
    # a lanelet through an intersection
    lanelet: int
    rank: int
    heading: float  # at the end of the incoming lanelet
    turn: str
    lights: bool


def has_right_of_way(network: Any) -> bool:
    """Tell whether a network has intersections or stop signs."""
    return bool(network.intersections) or any("STOP" in _signs(network, one) for one in network.lanelets)


def add_crossings(road: Road, network: Any, names: Sequence[int], routes: Sequence[Sequence[int]]) -> Road:
    """Return the road of an ego with the stop signs and the conflict areas on its way.

    Args:
        road: Road along these lanelets, with a line.
        network: Network of commonroad-io.
        names: Successive lanelets of the ego's way.
        routes: Those of each other vehicle.
    """
    assert road.line is not None
    known = {int(one.lanelet_id): one for one in network.lanelets}
    found: list[Crossing] = []
    for intersection in network.intersections:
        groups = [list(_list_ways(network, known, one)) for one in intersection.incomings]
        for group in groups:
            for mine in (way for way in group if way.lanelet in names):
                others = [way for other in groups if other is not group for way in other]
                found += _find_crossings(road.line, known, mine, others, routes)
    stops = (_stop_line(network, known[name]) for name in names)
    stations = [float(road.line.to_road(*point[:, None])[0][0]) for point in stops if point is not None]
    return dataclasses.replace(road, stop_signs=tuple(sorted(stations)), crossings=tuple(found))


def _list_ways(network: Any, known: Mapping[int, Any], incoming: Any) -> Iterator[_Way]:
    for name in sorted(incoming.incoming_lanelets or ()):
        one = known[int(name)]
        ranks = [_PRIORITY[sign] for sign in _signs(network, one) if sign in _PRIORITY]
        x, y = np.diff(np.asarray(one.center_vertices)[-2:, :2], axis=0)[0]
        for after in sorted(set(one.successor or ()) & set(known)):
            turns = (turn for turn in ("left", "straight", "right") if after in _outgoing(incoming, turn))
            lights = bool(one.traffic_lights)
            yield _Way(int(after), min(ranks, default=1), math.atan2(y, x), next(turns, ""), lights)


def _outgoing(incoming: Any, turn: str) -> set[int]:
    return set(getattr(incoming, f"outgoing_{turn}", None) or ())


def _signs(network: Any, lanelet: Any) -> set[str]:
    signs = (network.find_traffic_sign_by_id(number) for number in lanelet.traffic_signs or ())
    return {str(part.traffic_sign_element_id.name) for sign in signs for part in sign.traffic_sign_elements}


def _prefer(mine: _Way, other: _Way) -> Reason | None:
    # why the other way has priority; lights put signs and right before left out of force
    turned = math.remainder(other.heading - mine.heading, 2.0 * math.pi)
    against = abs(turned) > 0.75 * math.pi
    if other.rank > mine.rank and not mine.lights:
        return "sign"
    if other.rank < mine.rank and not mine.lights:
        return None
    if against:
        return "oncoming" if mine.turn == "left" and other.turn in ("straight", "right") else None
    return "right" if 0.25 * math.pi < turned and not mine.lights else None


def _find_crossings(
    line: ReferenceLine,
    known: Mapping[int, Any],
    mine: _Way,
    others: Sequence[_Way],
    routes: Sequence[Sequence[int]],
) -> Iterator[Crossing]:
    points = _list_points(known[mine.lanelet])
    for other in others:
        reason, lanelet = _prefer(mine, other), known[other.lanelet]
        if reason is None or other.lanelet == mine.lanelet:
            continue
        outline = np.concatenate([lanelet.left_vertices, lanelet.right_vertices[::-1]])[:, :2]
        common = points[is_inside(outline, points)]
        if not len(common):
            continue
        way = PolygonalLine(np.asarray(lanelet.center_vertices)[:, :2])
        x, stations = line.to_road(*common.T)[0], way.to_road(*common.T)[0]
        apart = np.hypot(*(np.asarray(lanelet.left_vertices) - lanelet.right_vertices)[:, :2].T)
        users = tuple(index for index, route in enumerate(routes) if other.lanelet in route)
        half_width = 0.5 * float(np.median(apart))
        yield Crossing(reason, *_range(x), way, *_range(stations), half_width, users)


def _range(values: Floats) -> tuple[float, float]:
    return float(np.nanmin(values)), float(np.nanmax(values))


def _list_points(lanelet: Any) -> Floats:
    # points inside a lanelet, a grid length apart or less
    left, right = (np.asarray(side)[:, :2] for side in (lanelet.left_vertices, lanelet.right_vertices))
    length = max(np.hypot(*np.diff(side, axis=0).T).sum() for side in (left, right))
    share = np.linspace(0.0, len(left) - 1.0, max(2, len(left), int(length / _GRID) + 1))
    rows = [
        np.stack([np.interp(share, np.arange(len(side)), side[:, i]) for i in (0, 1)], axis=1)
        for side in (left, right)
    ]
    across = max(2, int(np.hypot(*(left - right).T).max() / _GRID) + 1)
    weights = (np.arange(across) + 0.5)[:, None, None] / across
    return np.asarray((weights * rows[0] + (1.0 - weights) * rows[1]).reshape(-1, 2))


def _stop_line(network: Any, lanelet: Any) -> Floats | None:
    # the middle of the line, or of the lanelet's end where the file gives no line
    if "STOP" not in _signs(network, lanelet):
        return None
    line = getattr(lanelet, "stop_line", None)
    if line is None or line.start is None or line.end is None:
        return np.asarray(lanelet.center_vertices)[-1, :2]
    return np.asarray(0.5 * (np.asarray(line.start)[:2] + np.asarray(line.end)[:2]))
