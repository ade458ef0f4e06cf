"""Lines on a road, for pictures of it: the borders of its lanes, each once, and where a lane ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from avrare.driving.lanes import ENDLESS, list_lanes
from avrare.driving.values import Bools, Floats, Lane, Road

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
        there = _is_there(neighbour, middles)
        inner |= there & (np.abs((low if left else high) - at) < _TOUCHING)
        within |= there & (low + _TOUCHING < at) & (at < high - _TOUCHING)
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
        there, middle = np.array([x + outward]), 0.5 * (right + left)
        goes_on = any(
            _is_there(neighbour, there)[0]
            and np.interp(there, neighbour.stations, neighbour.right)[0] < middle
            and middle < np.interp(there, neighbour.stations, neighbour.left)[0]
            for neighbour in others
        )
        if not goes_on:
            yield Marking(np.full(2, x), np.array([right, left]), inner=False)


def _is_there(lane: Lane, x: Floats) -> Bools:
    return np.asarray((x >= lane.stations[0]) & (x <= lane.stations[-1]))
