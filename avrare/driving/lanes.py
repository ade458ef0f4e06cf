"""Lanes of a road: borders, the lanes that a box reaches into, the outermost one, and the lines to draw."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.driving.values import Bools, Floats, Lane, Road

ENDLESS = 1e5
"""Distance from the origin at which lanes without an end have theirs [m]."""


def list_lanes(road: Road) -> list[Lane]:
    """Return the lanes with their borders; parallel ones have no ends."""
    if road.lanes:
        return list(road.lanes)
    ends, half = np.array([-ENDLESS, ENDLESS]), 0.5 * road.lane_width
    return [Lane(ends, np.full(2, y - half), np.full(2, y + half)) for y in road.lane_centres]


def lane_borders(road: Road, x: Floats) -> tuple[Floats, Floats]:
    """Return y of the right and left borders (L, ...) at ``x``; beyond a lane's ends those of its end."""
    if not road.lanes:
        centres = np.array(road.lane_centres).reshape(-1, *[1] * x.ndim)
        return centres - 0.5 * road.lane_width, centres + 0.5 * road.lane_width
    right = [np.interp(x, lane.stations, lane.right) for lane in road.lanes]
    return np.array(right), np.array([np.interp(x, lane.stations, lane.left) for lane in road.lanes])


def lane_overlap(road: Road, x: Floats, y: Floats, half_length: Floats, half_width: Floats) -> Floats:
    """Return (L, ...) how far boxes reach into each lane [m], negative outside.

    A lane that begins or ends also bounds it along the road.
    """
    if not road.lanes:
        centres = np.array(road.lane_centres).reshape(-1, *[1] * y.ndim)
        return np.asarray(0.5 * road.lane_width + half_width - np.abs(y - centres))
    right, left = lane_borders(road, x)
    across = np.minimum(left - (y - half_width), (y + half_width) - right)
    begin, end = lane_ends(road, x.ndim)
    along = np.minimum(x + half_length - begin, end - (x - half_length))
    return np.asarray(np.minimum(across, along))


def lane_ends(road: Road, axes: int = 0) -> tuple[Floats, Floats]:
    """Return x where each lane begins and ends, (L, 1, ...) with ``axes`` trailing axes."""
    ends = np.array([(lane.stations[0], lane.stations[-1]) for lane in road.lanes])
    begin, end = ends.reshape(-1, 2, *[1] * axes).swapaxes(0, 1)
    return begin, end


def lane_exists(road: Road, x: Floats) -> Bools:
    """Return a mask (L, ...) of the lanes that exist at ``x``."""
    if not road.lanes:
        return np.ones((len(road.lane_centres), *x.shape), dtype=np.bool_)
    begin, end = lane_ends(road, x.ndim)
    return np.asarray((x >= begin) & (x <= end))


def is_outermost(road: Road, lanes: Sequence[int], x: Floats, side: float) -> Bools:
    """Return a mask (L, ...) of the outermost of ``lanes`` at ``x`` on a side: 1 is left, -1 right."""
    right, left = lane_borders(road, x)
    at = np.where(lane_exists(road, x), side * (right + left), -np.inf)
    others = np.setdiff1d(np.arange(len(road.lane_centres)), np.asarray(lanes, dtype=np.int64))
    at[others] = -np.inf
    return np.asarray((at == at.max(axis=0)) & np.isfinite(at))


_TOUCHING = 0.3
"""Most distance of two borders that are one line [m]."""


@dataclass(frozen=True, eq=False)
class Marking:
    """Line on a road.

    Attributes:
        x: (K,) stations [m].
        y: (K,) [m].
        inner: Whether there are lanes on both sides.
    """

    x: Floats
    y: Floats
    inner: bool


def list_markings(road: Road) -> list[Marking]:
    """Return the lines on a road: between two lanes, at its edges, and across a lane that ends within it."""
    lanes = list_lanes(road)
    markings: list[Marking] = []
    for k, lane in enumerate(lanes):
        others = [*lanes[:k], *lanes[k + 1 :]]
        markings += [*_borders(lane, others, left=True), *_borders(lane, others, left=False)]
        markings += _ends(lane, others, road)
    return markings


def _borders(lane: Lane, others: list[Lane], left: bool) -> Iterator[Marking]:
    # A right border that is the left one of another lane as well is not repeated, nor is one drawn within
    # another lane, where one merges.
    x = np.unique(np.concatenate([lane.stations, *(neighbour.stations for neighbour in others)]))
    x = x[(x >= lane.stations[0]) & (x <= lane.stations[-1])]
    y = np.interp(x, lane.stations, lane.left if left else lane.right)
    middles, at = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
    inner, within = np.zeros((2, len(middles)), dtype=np.bool_)
    for neighbour in others:
        low, high = (
            np.interp(middles, neighbour.stations, border) for border in (neighbour.right, neighbour.left)
        )
        exists = _is_there(neighbour, middles)
        inner |= exists & (np.abs((low if left else high) - at) < _TOUCHING)
        within |= exists & (low + _TOUCHING < at) & (at < high - _TOUCHING)
    kind = np.where(inner, 1, np.where(within, 2, 0))
    ends = np.flatnonzero(np.diff(kind)) + 1
    for begin, end in zip([0, *ends], [*ends, len(kind)], strict=True):
        if kind[begin] == 0 or (left and kind[begin] == 1):
            yield Marking(x[begin : end + 1], y[begin : end + 1], bool(inner[begin]))


def _ends(lane: Lane, others: list[Lane], road: Road) -> Iterator[Marking]:
    beyond = 0.01  # [m]
    # Where a map ends no line is drawn, nor where another lane goes on.
    for at, outward in ((0, -beyond), (-1, beyond)):
        x, right, left = (float(part[at]) for part in (lane.stations, lane.right, lane.left))
        if not road.begin < x < road.end or abs(x) >= ENDLESS or left - right < _TOUCHING:
            continue
        outer_x, middle = np.array([x + outward]), 0.5 * (right + left)
        goes_on = any(
            _is_there(neighbour, outer_x)[0]
            and np.interp(outer_x, neighbour.stations, neighbour.right)[0] < middle
            and middle < np.interp(outer_x, neighbour.stations, neighbour.left)[0]
            for neighbour in others
        )
        if not goes_on:
            yield Marking(np.full(2, x), np.array([right, left]), inner=False)


def _is_there(lane: Lane, x: Floats) -> Bools:
    return np.asarray((x >= lane.stations[0]) & (x <= lane.stations[-1]))
