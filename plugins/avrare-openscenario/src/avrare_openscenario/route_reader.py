"""Reading of routes, and of places along them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from avrare_openscenario.place_reader import read_orientation
from avrare_openscenario.routes import follow_lane
from avrare_openscenario.starts import place_point
from avrare_openscenario.story import Place, Route
from avrare_openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_openscenario.action_reader import ActionReader


def read_route(reader: ActionReader, action: Element, actor: int) -> Route:
    """Read an ``AssignRouteAction``."""
    places = _read_waypoints(reader, action)
    return Route(actor, tuple(place.roads for place in places if place.roads is not None))


def read_route_place(reader: ActionReader, position: Element) -> Place:
    """Read a ``RoutePosition``: a way along the lane of the first waypoint."""
    first, *others = _read_waypoints(reader, position.child("RouteRef"))
    where = position.child("InRoutePosition").choice()
    if where.tag not in ("FromLaneCoordinates", "FromRoadCoordinates"):
        raise where.unknown("FromLaneCoordinates, FromRoadCoordinates")
    assert first.roads is not None
    if first.lane is None:
        raise position.error("the first waypoint of the route is in no lane", "give a LanePosition")
    names = {index: lane for lane, index in first.roads.lanes.items()}
    wanted = [place.roads for place in others if place.roads is not None]
    line = follow_lane(reader.roads, first.roads, names[first.lane], wanted)
    pose = place_point(first, line, (line,), reader.parameters.table({}, 1), {})
    station = reader.parameters.shifted(reader.parameters.number(where, "pathS"), float(pose[0][0]))
    heading, absolute = read_orientation(position, reader.parameters)
    if where.tag == "FromLaneCoordinates":
        lane = reader.parameters.whole(where, "laneId")
        if lane not in line.lanes:
            raise where.error(f"there is no lane {lane}", "choose one of the first waypoint's road")
        offset, own = reader.parameters.number(where, "laneOffset", 0.0), line.lanes[lane]
        return Place("lane", station, offset, heading, own, absolute=absolute, roads=line)
    middle = -abs(first.roads.centres[names[first.lane]])
    across = reader.parameters.shifted(reader.parameters.number(where, "t"), -middle)
    return Place("road", station, across, heading, absolute=absolute, roads=line)


def _read_waypoints(reader: ActionReader, action: Element) -> list[Place]:
    route = reader.catalogs.find(action, "Route")
    route.skip_children("ParameterDeclarations")
    route.get("name")
    if reader.parameters.boolean(route, "closed"):
        raise route.error("a closed route is not read")
    places = []
    for point in route.list("Waypoint"):
        point.get("routeStrategy")
        place = reader.read_place(point.child("Position"))
        if place.roads is None and place.kind != "plane":
            raise point.error("a waypoint that is relative to an entity is not read")
        x, y = reader.parameters.table({}, 1)[0, [place.x, place.y]]
        places.append(replace(place, roads=place.roads or reader.roads.find_nearest(x, y)))
    if not places:
        raise route.error("has no Waypoint")
    return places
