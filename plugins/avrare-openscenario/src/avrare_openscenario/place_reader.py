"""Reading of positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from avrare.base.errors import did_you_mean
from avrare_openscenario.network import Network, RoadMap
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.story import Place
from avrare_openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_openscenario.action_reader import ActionReader

POSITIONS = (
    "WorldPosition, LanePosition, RoadPosition, RelativeLanePosition, RelativeRoadPosition, "
    "RelativeObjectPosition, RelativeWorldPosition, TrajectoryPosition, RoutePosition"
)


def read_place(
    position: Element,
    parameters: Parameters,
    roads: Network,
    names: Sequence[str],
    curves: ActionReader | None = None,
) -> Place:
    """Read the element ``Position``; ``names`` are those of the entities, the ego last."""
    place = _read_kind(position.choice(), parameters, roads, names, curves)
    return replace(place, turned=place.turned or position.children[0].find("Orientation") is not None)


def _read_kind(
    one: Element, parameters: Parameters, roads: Network, names: Sequence[str], curves: ActionReader | None
) -> Place:

    def number(name: str, default: float | None = None) -> Number:
        return parameters.number(one, name, default)

    match one.tag:
        case "WorldPosition":
            for name in ("z", "p", "r"):
                one.get(name)
            turned = one.get("h") is not None
            return Place("plane", number("x"), number("y"), number("h", 0.0), absolute=True, turned=turned)
        case "RelativeWorldPosition":
            other = find_entity(one, "entityRef", parameters, names)
            one.get("dz")
            heading, absolute = read_orientation(one, parameters)
            return Place("shifted", number("dx"), number("dy"), heading, None, other, absolute)
        case "RoutePosition" if curves is not None:
            from avrare_openscenario.route_reader import read_route_place  # which reads places itself

            return read_route_place(curves, one)
        case "TrajectoryPosition" if curves is not None:
            heading, absolute = read_orientation(one, parameters)
            curve = curves.read_curve(one.find("TrajectoryRef") or one, -1, False)
            return Place("curve", number("s"), number("t", 0.0), heading, absolute=absolute, curve=curve)
        case "LanePosition":
            line = find_road(one, parameters, roads)
            lane = parameters.whole(one, "laneId")
            heading, absolute = read_orientation(one, parameters)
            station, offset = _read_station(one, parameters, line), number("offset", 0.0)
            if lane in line.lanes:
                index = line.lanes[lane]
                return Place("lane", station, offset, heading, index, absolute=absolute, roads=line)
            if lane not in line.centres:
                raise one.error(f"there is no lane {lane}", f"lanes of the road: {_list_lanes(line)}")
            beside = parameters.shifted(offset, line.centres[lane])
            return Place("road", station, beside, heading, absolute=absolute, roads=line)
        case "RoadPosition":
            line = find_road(one, parameters, roads)
            station = _read_station(one, parameters, line)
            heading, absolute = read_orientation(one, parameters)
            return Place("road", station, number("t"), heading, absolute=absolute, roads=line)
        case "RelativeLanePosition":
            other = find_entity(one, "entityRef", parameters, names)
            heading, absolute = read_orientation(one, parameters)
            across = parameters.whole(one, "dLane")
            ahead = number("ds" if one.get("dsLane") is None else "dsLane", 0.0)
            offset = number("offset", 0.0)
            by_lane = one.get("dsLane") is not None
            return Place("beside", ahead, offset, heading, across, other, absolute, by_lane=by_lane)
        case "RelativeRoadPosition":
            other = find_entity(one, "entityRef", parameters, names)
            heading, absolute = read_orientation(one, parameters)
            return Place("beside", number("ds"), number("dt"), heading, None, other, absolute)
        case "RelativeObjectPosition":
            other = find_entity(one, "entityRef", parameters, names)
            one.get("dz")
            heading, absolute = read_orientation(one, parameters)
            return Place("ahead", number("dx"), number("dy"), heading, None, other, absolute)
    raise one.unknown(POSITIONS)


def find_entity(element: Element, name: str, parameters: Parameters, names: Sequence[str]) -> int:
    """Return the index of the entity that an attribute names."""
    text = parameters.text(element, name)
    if text not in names:
        raise element.error(f"there is no entity {text!r}", did_you_mean(text, names))
    return list(names).index(text)


def find_lane(element: Element, name: str, parameters: Parameters, roads: Network) -> int:
    """Return the id of a lane of one of the roads, which an attribute has."""
    lane = parameters.whole(element, name)
    if not any(lane in line.lanes for line in roads.maps):
        driven = any(lane in line.centres for line in roads.maps)
        text = f"nobody drives on lane {lane}" if driven else f"there is no lane {lane}"
        raise element.error(text, f"lanes of the road: {_list_lanes(*roads.maps)}")
    return lane


def find_road(element: Element, parameters: Parameters, roads: Network) -> RoadMap:
    """Return the road that the attribute ``roadId`` names."""
    road = parameters.text(element, "roadId")
    line = roads.find(road)
    if line is None:
        known = ", ".join(name for line in roads.maps for name in line.begins)
        raise element.error(f"there is no road {road!r}", f"there are: {known}")
    return line


def _list_lanes(*lines: RoadMap) -> str:
    return ", ".join(map(str, sorted({lane for line in lines for lane in line.lanes})))


def _read_station(element: Element, parameters: Parameters, line: RoadMap) -> Number:
    begin = line.begins[parameters.text(element, "roadId")]
    return parameters.shifted(parameters.number(element, "s"), begin)


def read_orientation(position: Element, parameters: Parameters) -> tuple[Number, bool]:
    """Return the heading that a position has, and whether it is one in the plane."""
    found = position.find("Orientation")
    if found is None:
        return parameters.constant(0.0), False
    for name in ("p", "r"):
        found.get(name)
    kind = found.get("type") or "absolute"
    if kind not in ("absolute", "relative"):
        raise found.error(f"type should be absolute or relative, found {kind!r}")
    return parameters.number(found, "h", 0.0), kind == "absolute"
