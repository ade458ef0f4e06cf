"""Starts of vehicles: places of a file in the frame of the road."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare_single_track.openscenario.opendrive import RoadMap
from avrare_single_track.openscenario.story import Place, Storyboard

Integers = NDArray[np.int64]


def nearest_lane(roads: RoadMap, y: Floats) -> Integers:
    """Return the index of the lane whose centre is nearest to offsets of any shape."""
    centres = np.array(roads.road.lane_centres)
    return np.asarray(np.abs(np.asarray(y)[..., None] - centres).argmin(axis=-1))


def lane_middle(roads: RoadMap, lane: Integers) -> Floats:
    """Return y of the centre of lanes [m], NaN where there is no such lane."""
    centres = np.array(roads.road.lane_centres)
    inside = (lane >= 0) & (lane < len(centres))
    return np.where(inside, centres[np.where(inside, lane, 0)], np.nan)


def lane_direction(roads: RoadMap, y: Floats) -> Floats:
    """Return 1 where traffic goes along the road, -1 where it comes towards it."""
    opposing = np.isin(nearest_lane(roads, y), roads.road.opposing)
    return np.where(opposing, -1.0, 1.0)


def place_all(
    story: Storyboard, roads: RoadMap, table: Floats, ahead: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return stations, offsets and headings (N, V + 1) of the middles of all vehicles at the start.

    Args:
        story: Places of the vehicles.
        roads: The road.
        table: (N, K) numbers of the file.
        ahead: (V + 1,) how far each middle is ahead of the point that a file places [m].

    Raises:
        UsageError: Places are relative to each other in a circle.
    """
    found: dict[int, tuple[Floats, Floats, Floats]] = {}
    waiting = list(range(len(story.places)))
    while waiting:
        ready = [k for k in waiting if story.places[k].other < 0 or story.places[k].other in found]
        if not ready:
            raise UsageError("the starts of vehicles are relative to each other in a circle")
        for k in ready:
            found[k] = place_point(story.places[k], roads, table, found)
        waiting = [k for k in waiting if k not in found]
    s, d, heading = (np.stack([found[k][part] for k in range(len(found))], axis=1) for part in range(3))
    return move_along_body(roads, s, d, heading, ahead)


def move_along_body(
    roads: RoadMap, s: Floats, d: Floats, heading: Floats, by: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return poses that are ``by`` further ahead along the bodies."""
    across = by * np.sin(heading)
    along = by * np.cos(heading)
    line = roads.road.line
    moved = s + along if line is None else line.advance(s, d + 0.5 * across, along)
    return moved, d + across, heading


def place_point(
    place: Place, roads: RoadMap, table: Floats, others: dict[int, tuple[Floats, Floats, Floats]]
) -> tuple[Floats, Floats, Floats]:
    """Return station, offset and heading (N,) of one place; ``others`` are those found before."""
    x, y, heading = (table[:, number] for number in (place.x, place.y, place.heading))
    if place.kind == "plane":
        s, d = roads.line.to_road(x, y)
        return s, d, heading - roads.line.heading(s)
    if place.kind == "road":
        s, d = x, y
    elif place.kind == "lane":
        assert place.lane is not None
        s, d = x, y + roads.road.lane_centres[place.lane]
    else:
        their_s, their_d, their_heading = others[place.other]
        along = lane_direction(roads, their_d)
        if place.kind == "ahead":
            cos, sin = np.cos(their_heading), np.sin(their_heading)
            s, d = their_s + cos * x - sin * y, their_d + sin * x + cos * y
        elif place.lane is None:
            s, d = their_s + x, their_d + y
        else:
            lane = nearest_lane(roads, their_d) + (along * place.lane).astype(np.int64)
            s, d = their_s + along * x, lane_middle(roads, lane) + y
    if place.absolute:
        return s, d, heading - roads.line.heading(s)
    return s, d, heading + np.where(lane_direction(roads, d) < 0.0, np.pi, 0.0)
