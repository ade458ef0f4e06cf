"""Reading of routes, and of places along them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from avrare_openscenario.network import RoadMap
from avrare_openscenario.place_reader import read_orientation
from avrare_openscenario.routes import follow_lane
from avrare_openscenario.starts import place_point
from avrare_openscenario.story import Place, Route
from avrare_openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_openscenario.action_reader import ActionReader


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


def read_route_place(reader: ActionReader, position: Element) -> Place:
    """Read a ``RoutePosition``: a way along the lane of the first waypoint."""
    (first, roads), *others = _read_waypoints(reader, position.child("RouteRef"))
    where = position.child("InRoutePosition").choice()
    lane_known = where.tag in ("FromLaneCoordinates", "PositionInLaneCoordinates")  # 1.0 calls it so
    if not lane_known and where.tag not in ("FromRoadCoordinates", "PositionInRoadCoordinates"):
        raise where.unknown("FromLaneCoordinates, FromRoadCoordinates")
    if first.lane is None:
        raise position.error("the first waypoint of the route is in no lane", "give a LanePosition")
    names = {index: lane for lane, index in roads.lanes.items()}
    line = follow_lane(reader.roads, roads, names[first.lane], [after for _, after in others])
    pose = place_point(first, line, (line,), reader.parameters.table({}, 1), {})
    station = reader.parameters.shifted(reader.parameters.number(where, "pathS"), float(pose[0][0]))
    heading, absolute = read_orientation(position, reader.parameters)
    if lane_known:
        lane = reader.parameters.whole(where, "laneId")
        if lane not in line.lanes:
            raise where.error(f"there is no lane {lane}", "choose one of the first waypoint's road")
        offset, own = reader.parameters.number(where, "laneOffset", 0.0), line.lanes[lane]
        return Place("lane", station, offset, heading, own, absolute=absolute, roads=line)
    middle = -abs(roads.centres[names[first.lane]])
    across = reader.parameters.shifted(reader.parameters.number(where, "t"), -middle)
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
