"""Reading of positions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from avrare_openscenario.network import RoadMap
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.story import Place
from avrare_openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_openscenario.action_reader import ActionReader

POSITIONS = (
    "WorldPosition, LanePosition, RoadPosition, RelativeLanePosition, RelativeRoadPosition, "
    "RelativeObjectPosition, RelativeWorldPosition, TrajectoryPosition, RoutePosition"
)


def read_place(reader: ActionReader, position: Element) -> Place:
    """Read the element ``Position``."""
    place = _read_kind(reader, position.choice())
    return replace(place, turned=place.turned or position.children[0].find("Orientation") is not None)


def _read_kind(reader: ActionReader, one: Element) -> Place:
    parameters = reader.parameters

    def number(name: str, default: float | None = None) -> Number:
        return parameters.number(one, name, default)

    if one.tag == "WorldPosition":
        for name in ("z", "p", "r"):
            one.get(name)
        turned = one.get("h") is not None
        return Place("plane", number("x"), number("y"), number("h", 0.0), absolute=True, turned=turned)
    if one.tag == "RoutePosition":
        from avrare_openscenario.route_reader import read_route_place  # which reads places itself

        return read_route_place(reader, one)
    heading, absolute = read_orientation(one, parameters)
    match one.tag:
        case "RelativeWorldPosition":
            one.get("dz")
            other = reader.find_entity(one)
            return Place("shifted", number("dx"), number("dy"), heading, None, other, absolute)
        case "TrajectoryPosition":
            curve = reader.read_curve(one.find("TrajectoryRef") or one, -1, False)
            return Place("curve", number("s"), number("t", 0.0), heading, absolute=absolute, curve=curve)
        case "LanePosition":
            line, station = _read_station(reader, one)
            lane, offset = parameters.whole(one, "laneId"), number("offset", 0.0)
            if lane in line.lanes:
                index = line.lanes[lane]
                return Place("lane", station, offset, heading, index, absolute=absolute, roads=line)
            if lane not in line.centres:
                raise one.error(f"there is no lane {lane}", f"lanes of the road: {_list_lanes(line)}")
            beside = parameters.shifted(offset, line.centres[lane])
            return Place("road", station, beside, heading, absolute=absolute, roads=line)
        case "RoadPosition":
            line, station = _read_station(reader, one)
            return Place("road", station, number("t"), heading, absolute=absolute, roads=line)
        case "RelativeLanePosition":
            other, across = reader.find_entity(one), parameters.whole(one, "dLane")
            by_lane = one.get("dsLane") is not None
            ahead, offset = number("dsLane" if by_lane else "ds", 0.0), number("offset", 0.0)
            return Place("beside", ahead, offset, heading, across, other, absolute, by_lane=by_lane)
        case "RelativeRoadPosition":
            other = reader.find_entity(one)
            return Place("beside", number("ds"), number("dt"), heading, None, other, absolute)
        case "RelativeObjectPosition":
            one.get("dz")
            other = reader.find_entity(one)
            return Place("ahead", number("dx"), number("dy"), heading, None, other, absolute)
    raise one.unknown(POSITIONS)


def find_lane(reader: ActionReader, element: Element, name: str) -> int:
    """Return the id of a lane of one of the roads, which an attribute has."""
    lane, lines = reader.parameters.whole(element, name), reader.roads.maps
    if not any(lane in line.lanes for line in lines):
        driven = any(lane in line.centres for line in lines)
        text = f"nobody drives on lane {lane}" if driven else f"there is no lane {lane}"
        raise element.error(text, f"lanes of the road: {_list_lanes(*lines)}")
    return lane


def _list_lanes(*lines: RoadMap) -> str:
    return ", ".join(map(str, sorted({lane for line in lines for lane in line.lanes})))


def _read_station(reader: ActionReader, element: Element) -> tuple[RoadMap, Number]:
    # The line of the road that the attribute ``roadId`` names, and a station on it.
    road = reader.parameters.text(element, "roadId")
    line = reader.roads.find(road)
    if line is None:
        known = ", ".join(name for line in reader.roads.maps for name in line.begins)
        raise element.error(f"there is no road {road!r}", f"there are: {known}")
    return line, reader.parameters.shifted(reader.parameters.number(element, "s"), line.begins[road])


def read_orientation(position: Element, parameters: Parameters) -> tuple[Number, bool]:
    """Return the heading that a position has, and whether it is one in the plane."""
    found = position.find("Orientation")
    if found is None:
        return parameters.constant(0.0), False
    for name in ("p", "r"):
        found.get(name)
    kind = parameters.choose(found, "type", ("absolute", "relative"), "absolute")
    return parameters.number(found, "h", 0.0), kind == "absolute"
