"""Reading of positions and routes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from avrare_openscenario.network import RoadMap
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.routes import follow_lane
from avrare_openscenario.starts import place_point
from avrare_openscenario.story import Place, Route
from avrare_openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_openscenario.action_reader import ActionReader

_POSITIONS = (
    *("WorldPosition", "LanePosition", "RoadPosition", "TrajectoryPosition", "RoutePosition"),
    *("RelativeLanePosition", "RelativeRoadPosition", "RelativeObjectPosition", "RelativeWorldPosition"),
)


def read_place(reader: ActionReader, position: Element) -> Place:
    """Read the element ``Position``."""
    place = _read_kind(reader, position.choice(*_POSITIONS))
    return replace(place, turned=place.turned or position.children[0].find("Orientation") is not None)


def _read_kind(reader: ActionReader, position: Element) -> Place:
    parameters = reader.parameters

    def number(name: str, default: float | None = None) -> Number:
        return parameters.number(position, name, default)

    if position.tag == "WorldPosition":
        position.ignore("z", "p", "r")
        turned = position.get("h") is not None
        return Place("plane", number("x"), number("y"), number("h", 0.0), absolute=True, turned=turned)
    if position.tag == "RoutePosition":
        return _read_route_place(reader, position)
    heading, absolute = _read_orientation(position, parameters)
    match position.tag:
        case "TrajectoryPosition":
            curve = reader.read_curve(position.find("TrajectoryRef") or position, -1, False)
            return Place("curve", number("s"), number("t", 0.0), heading, absolute=absolute, curve=curve)
        case "LanePosition":
            line, station = _read_station(reader, position)
            lane, offset = parameters.read_integer(position, "laneId"), number("offset", 0.0)
            if lane in line.lanes:
                index = line.lanes[lane]
                return Place("lane", station, offset, heading, index, absolute=absolute, roads=line)
            if lane not in line.centres:
                raise position.error(f"there is no lane {lane}", f"lanes of the road: {_list_lanes(line)}")
            aside = parameters.shift(offset, line.centres[lane])
            return Place("road", station, aside, heading, absolute=absolute, roads=line)
        case "RoadPosition":
            line, station = _read_station(reader, position)
            return Place("road", station, number("t"), heading, absolute=absolute, roads=line)
        case "RelativeLanePosition":
            other, across = reader.find_entity(position), parameters.read_integer(position, "dLane")
            by_lane = position.get("dsLane") is not None
            ahead, offset = number("dsLane" if by_lane else "ds", 0.0), number("offset", 0.0)
            return Place("beside", ahead, offset, heading, across, other, absolute, by_lane=by_lane)
        case "RelativeRoadPosition":
            other = reader.find_entity(position)
            return Place("beside", number("ds"), number("dt"), heading, None, other, absolute)
    position.ignore("dz")
    kind: Literal["shifted", "ahead"] = "shifted" if position.tag == "RelativeWorldPosition" else "ahead"
    return Place(kind, number("dx"), number("dy"), heading, None, reader.find_entity(position), absolute)


def find_lane(reader: ActionReader, element: Element, name: str) -> int:
    """Return the id of a lane of position of the roads, which an attribute has."""
    lane, lines = reader.parameters.read_integer(element, name), reader.roads.maps
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
        names = ", ".join(name for line in reader.roads.maps for name in line.begins)
        raise element.error(f"there is no road {road!r}", f"there are: {names}")
    return line, reader.parameters.shift(reader.parameters.number(element, "s"), line.begins[road])


def _read_orientation(position: Element, parameters: Parameters) -> tuple[Number, bool]:
    # The heading that a position has, and whether it is one in the plane.
    orientation = position.find("Orientation")
    if orientation is None:
        return parameters.constant(0.0), False
    orientation.ignore("p", "r")
    kind = parameters.choose(orientation, "type", ("absolute", "relative"), "absolute")
    return parameters.number(orientation, "h", 0.0), kind == "absolute"


def read_route(reader: ActionReader, action: Element, actor: int) -> Route:
    """Read an ``AssignRouteAction``, or an ``AcquirePositionAction``: a route of one point."""
    acquires = action.tag == "AcquirePositionAction"
    points = [_read_waypoint(reader, action)] if acquires else _read_waypoints(reader, action)
    return Route(actor, tuple(roads for _, roads in points))


def _read_waypoint(reader: ActionReader, point: Element) -> tuple[Place, RoadMap]:
    # The position of an element, and the road of it or next to it.
    place = reader.read_place(point.child("Position"))
    if place.roads is None and place.kind != "plane":
        raise point.error("a place that is relative to an entity is not read here")
    x, y = reader.parameters.table({}, 1)[0, [place.x, place.y]]
    return place, place.roads or reader.roads.find_nearest(x, y)


def _read_route_place(reader: ActionReader, position: Element) -> Place:
    # A ``RoutePosition``: a way along the lane of the first waypoint.
    (first, roads), *others = _read_waypoints(reader, position.child("RouteRef"))
    by_lane = ("FromLaneCoordinates", "PositionInLaneCoordinates")  # 1.0 calls it so
    by_road = ("FromRoadCoordinates", "PositionInRoadCoordinates")
    where = position.child("InRoutePosition").choice(*by_lane, *by_road)
    if first.lane is None:
        raise position.error("the first waypoint of the route is in no lane", "give a LanePosition")
    names = {index: lane for lane, index in roads.lanes.items()}
    line = follow_lane(reader.roads, roads, names[first.lane], [after for _, after in others])
    pose = place_point(first, line, (line,), reader.parameters.table({}, 1), {})
    station = reader.parameters.shift(reader.parameters.number(where, "pathS"), float(pose[0][0]))
    heading, absolute = _read_orientation(position, reader.parameters)
    if where.tag in by_lane:
        lane = reader.parameters.read_integer(where, "laneId")
        if lane not in line.lanes:
            raise where.error(f"there is no lane {lane}", "choose one of the first waypoint's road")
        offset = reader.parameters.number(where, "laneOffset", 0.0)
        return Place("lane", station, offset, heading, line.lanes[lane], absolute=absolute, roads=line)
    middle = -abs(roads.centres[names[first.lane]])
    across = reader.parameters.shift(reader.parameters.number(where, "t"), -middle)
    return Place("road", station, across, heading, absolute=absolute, roads=line)


def _read_waypoints(reader: ActionReader, action: Element) -> list[tuple[Place, RoadMap]]:
    route = reader.catalogs.find(action, "Route")
    route.skip_children("ParameterDeclarations")
    route.get("name")
    if reader.parameters.boolean(route, "closed"):
        route.note("a closed route is driven once")
    points = route.list("Waypoint")
    for point in points:
        point.get("routeStrategy")
    if not points:
        raise route.error("has no Waypoint")
    return [_read_waypoint(reader, point) for point in points]
