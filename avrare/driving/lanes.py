"""Lanes of a road: borders, which lanes a box reaches into, which lane is the outermost."""

from __future__ import annotations

from collections.abc import Sequence

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
    """Tell (L, ...) which lanes there are at ``x``."""
    if not road.lanes:
        return np.ones((len(road.lane_centres), *x.shape), dtype=np.bool_)
    begin, end = lane_ends(road, x.ndim)
    return np.asarray((x >= begin) & (x <= end))


def is_outermost(road: Road, lanes: Sequence[int], x: Floats, side: float) -> Bools:
    """Tell (L, ...) which of ``lanes`` is there at ``x`` the leftmost (side 1) or the rightmost (side -1)."""
    right, left = lane_borders(road, x)
    at = np.where(lane_exists(road, x), side * (right + left), -np.inf)
    others = np.setdiff1d(np.arange(len(road.lane_centres)), np.asarray(lanes, dtype=np.int64))
    at[others] = -np.inf
    return np.asarray((at == at.max(axis=0)) & np.isfinite(at))
