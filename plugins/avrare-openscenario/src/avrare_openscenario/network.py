"""Roads as a scene uses them: lines of roads, ways along lanes, and where they lead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import CurvedLine, Piece, ReferenceLine
from avrare.protocols import Floats

_ASIDE = 0.01
"""Least change of the place of a lane's centre that makes it bend [m]."""
_FAR = 50_000.0
"""Reach of a plane without roads [m]."""


@dataclass(frozen=True, eq=False)
class RoadMap:
    """Road of a file, with the names by which the file calls its parts.

    Attributes:
        road: Road.
        line: Reference line in the plane of the file, also where the road is straight.
        begins: Station at which each road of the file begins [m].
        lanes: Index of each lane, by its id.
        centres: y of each lane's centre, by its id, for lanes that nobody drives on as well [m].
        closed: Whether its end is its begin.
        legs: Lanes that it follows from one to the next; empty: it is a line of roads itself.
    """

    road: Road
    line: ReferenceLine
    begins: Mapping[str, float]
    lanes: Mapping[int, int]
    centres: Mapping[int, float]
    closed: bool = False
    legs: tuple[Leg, ...] = ()

    def find_leg(self, s: float) -> Leg:
        """Return the leg at a station, of a way through several roads."""
        begins = [leg.begin for leg in self.legs]
        return self.legs[max(int(np.searchsorted(begins, s, side="right")) - 1, 0)]

    def name_lane(self, index: int) -> int:
        """Return the id of a lane by its index, 0 where there is no such lane."""
        return next((name for name, number in self.lanes.items() if number == index), 0)

    def bends(self, lane: int) -> bool:
        """Return whether the centre of a lane moves aside along the line."""
        lanes = self.road.lanes
        if not lanes or lane not in self.lanes:
            return False
        border = lanes[self.lanes[lane]]
        return bool(np.ptp(border.right + border.left) > _ASIDE)

    def middles(self, s: Floats) -> Floats:
        """Return y (..., L) of the centre of each lane at stations (...) [m]."""
        if not self.road.lanes:
            return np.broadcast_to(np.array(self.road.lane_centres), (*s.shape, len(self.road.lane_centres)))
        s = np.clip(s, 0.0, self.line.length)
        centres = [
            np.interp(s, lane.stations, 0.5 * (lane.right + lane.left), np.nan, np.nan)
            for lane in self.road.lanes
        ]
        return np.stack(centres, axis=-1)

    def borders(self, index: int, s: Floats) -> tuple[Floats, Floats]:
        """Return y of the left and of the right border of a lane at stations [m]."""
        if self.road.lanes:
            lane = self.road.lanes[index]
            left, right = (
                np.interp(s, lane.stations, side, np.nan, np.nan) for side in (lane.left, lane.right)
            )
            return left, right
        half = np.full_like(s, 0.5 * self.road.lane_width)
        return self.road.lane_centres[index] + half, self.road.lane_centres[index] - half


@dataclass(frozen=True)
class Leg:
    """Lane of a line of roads on a way.

    Attributes:
        roads: The line.
        lane: Id of the lane.
        direction: Whether it is driven along (1) or against (-1) the line.
        begin: Station of the way at which it begins [m].
    """

    roads: RoadMap
    lane: int
    direction: int
    begin: float = 0.0


@dataclass(frozen=True)
class Connection:
    """Way from a lane at an end of a line of roads into another line.

    Attributes:
        roads: The other line.
        direction: Whether it is driven along (1) or against (-1) it.
        lanes: Id of the lane there, by that of the lane here.
        span: Stations there at which the road that connects begins and ends [m].
        junction: Id of the junction in which it lies; empty: none.
        rank: 2 where signs give it priority, 1 without signs, 0 where it yields, -1 where it stops.
        lights: Whether traffic lights are at its begin.
    """

    roads: RoadMap
    direction: int
    lanes: Mapping[int, int]
    span: tuple[float, float] = (0.0, 0.0)
    junction: str = ""
    rank: int = 1
    lights: bool = False


@dataclass(frozen=True)
class Network:
    """Roads of a file, in lines that each follow one another.

    Attributes:
        maps: The lines.
        notes: What of the file is left out, with its places.
        connections: Ways on from each line (its identity) at its end (1) and its begin (-1).
    """

    maps: tuple[RoadMap, ...]
    notes: tuple[str, ...] = ()
    connections: Mapping[tuple[int, int], Sequence[Connection]] = field(default_factory=dict)

    def find(self, road: str) -> RoadMap | None:
        """Return the line that a road belongs to."""
        return next((line for line in self.maps if road in line.begins), None)

    def find_ways(self, roads: RoadMap, direction: int) -> Sequence[Connection]:
        """Return the ways on from a line that is driven along (1) or against (-1) it."""
        return self.connections.get((id(roads), direction), ())

    def find_nearest(self, x: float, y: float) -> RoadMap:
        """Return the line that is nearest to a place in the plane."""

        def distance(roads: RoadMap) -> float:
            s, d = roads.line.to_road(np.array([x]), np.array([y]))
            outside = max(0.0 - s[0], s[0] - roads.line.length, 0.0)
            return float(abs(d[0]) + outside) if np.isfinite(s[0]) else np.inf

        return min(self.maps, key=distance)


def open_plane() -> Network:
    """Return the plane without roads, as a road without lanes along its x axis."""
    line = CurvedLine((Piece(2.0 * _FAR),), -_FAR)
    return Network((RoadMap(Road((), 0.0, end=line.length), line, {}, {}, {}),))
