"""Road network of a scene: chains of roads, routes along lanes, and the connections between chains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import CurvedLine, Piece, ReferenceLine
from avrare.protocols import Floats

_ASIDE = 0.01
"""Change of the lateral position of a lane's centre from which the lane counts as bent [m]."""
_FAR = 50_000.0
"""Reach of a plane without roads [m]."""


@dataclass(frozen=True, eq=False)
class RoadMap:
    """Chain of roads of the file that continue one another, or a route along lanes of several chains.

    Attributes:
        road: The chain as one road of the simulation.
        line: Reference line in the plane of the file, also where the road is straight.
        begins: Station at which each road of the file begins, by its id [m].
        lanes: Index of each lane in ``road``, by its id in the file.
        centres: y of the centre of each lane of the file, by its id, whether it can be driven on or not [m].
        closed: Whether the chain ends where it begins.
        legs: Lanes of a route in the order of driving; empty for a chain.
        tilt: (4, M) stations [m], slope, bank [rad] and change of that [rad/m]; None: it is flat.
    """

    road: Road
    line: ReferenceLine
    begins: Mapping[str, float]
    lanes: Mapping[int, int]
    centres: Mapping[int, float]
    closed: bool = False
    legs: tuple[Leg, ...] = ()
    tilt: Floats | None = None

    def find_leg(self, s: float) -> Leg:
        """Return the leg of a route at a station."""
        begins = [leg.begin for leg in self.legs]
        return self.legs[max(int(np.searchsorted(begins, s, side="right")) - 1, 0)]

    def name_lane(self, index: int) -> int:
        """Return the id of the lane with an index, 0 where no lane has it."""
        return next((name for name, number in self.lanes.items() if number == index), 0)

    def bends(self, lane: int) -> bool:
        """Return whether the lateral position of a lane's centre changes along the reference line."""
        lanes = self.road.lanes
        if not lanes or lane not in self.lanes:
            return False
        border = lanes[self.lanes[lane]]
        return bool(np.ptp(border.right + border.left) > _ASIDE)

    def see_from_above(self, s: Floats, d: Floats, heading: Floats) -> tuple[Floats, Floats, Floats]:
        """Return a pose on the surface of the road as it is in the plane."""
        if self.tilt is None:
            return s, d, heading
        slope, bank, change = (np.interp(s, self.tilt[0], row) for row in self.tilt[1:])
        pitch, nose = -np.arctan(slope), -np.cos(heading) * np.arctan(d * np.tan(change))
        side, up = np.sin(heading) * np.cos(nose), -np.sin(nose)
        ahead = np.cos(heading) * np.cos(nose) * np.cos(pitch)
        ahead += np.sin(pitch) * (side * np.sin(bank) + up * np.cos(bank))
        turned = np.arctan2(side * np.cos(bank) - up * np.sin(bank), ahead)
        return s + d * np.sin(bank) * np.sin(pitch), d * np.cos(bank), turned

    def middles(self, s: Floats) -> Floats:
        """Return the lateral positions (..., L) of the centres of all lanes at stations (...) [m]."""
        if not self.road.lanes:
            return np.broadcast_to(np.array(self.road.lane_centres), (*s.shape, len(self.road.lane_centres)))
        s = np.clip(s, 0.0, self.line.length)
        centres = [
            np.interp(s, lane.stations, 0.5 * (lane.right + lane.left), np.nan, np.nan)
            for lane in self.road.lanes
        ]
        return np.stack(centres, axis=-1)

    def borders(self, index: int, s: Floats) -> tuple[Floats, Floats]:
        """Return the lateral positions of the left and the right border of a lane at stations [m]."""
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
    """Part of a route that stays in one lane of one chain of roads.

    Attributes:
        roads: The chain.
        lane: Id of the lane.
        direction: 1 where the route follows the reference line of the chain, -1 where it runs against it.
        begin: Station of the route at which this part begins [m].
    """

    roads: RoadMap
    lane: int
    direction: int
    begin: float = 0.0


@dataclass(frozen=True)
class Connection:
    """Connection from the end of one chain of roads to a second chain, in the direction of travel.

    Attributes:
        roads: The second chain.
        direction: 1 where traffic follows the reference line of that chain, -1 where it runs against it.
        lanes: Id of the lane in the second chain, by the id of the lane in the first.
        span: Stations of the second chain between which the connecting road lies [m].
        junction: Id of the junction that contains the connecting road; empty: none.
        rank: Priority at the junction: 2 by signs, 1 without signs, 0 after yielding, -1 after stopping.
        lights: Whether traffic lights stand at the start of the connection.
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
    """All roads of a file as chains, and the connections between them.

    Attributes:
        maps: The chains.
        notes: Parts of the file that are not supported, with their places.
        connections: Connections from each chain (by ``id``) at its end (1) and at its start (-1).
    """

    maps: tuple[RoadMap, ...]
    notes: tuple[str, ...] = ()
    connections: Mapping[tuple[int, int], Sequence[Connection]] = field(default_factory=dict)

    def find(self, road: str) -> RoadMap | None:
        """Return the chain that contains a road of the file."""
        return next((line for line in self.maps if road in line.begins), None)

    def find_ways(self, roads: RoadMap, direction: int) -> Sequence[Connection]:
        """Return the connections from a chain that is driven along (1) or against (-1) its line."""
        return self.connections.get((id(roads), direction), ())

    def find_nearest(self, x: float, y: float) -> RoadMap:
        """Return the chain nearest to a point of the plane."""

        def distance(roads: RoadMap) -> float:
            s, d = roads.line.to_road(np.array([x]), np.array([y]))
            outside = max(0.0 - s[0], s[0] - roads.line.length, 0.0)
            return float(abs(d[0]) + outside) if np.isfinite(s[0]) else np.inf

        return min(self.maps, key=distance)


def open_plane() -> Network:
    """Return a plane without roads: one road without lanes along the x axis."""
    line = CurvedLine((Piece(2.0 * _FAR),), -_FAR)
    return Network((RoadMap(Road((), 0.0, end=line.length), line, {}, {}, {}),))
