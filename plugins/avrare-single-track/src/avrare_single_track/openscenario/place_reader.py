"""Reading of positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from avrare.base.errors import did_you_mean
from avrare_single_track.openscenario.opendrive import RoadMap
from avrare_single_track.openscenario.parameters import Number, Parameters
from avrare_single_track.openscenario.story import Place
from avrare_single_track.openscenario.xml_tree import Element

if TYPE_CHECKING:
    from avrare_single_track.openscenario.story import Trajectory

POSITIONS = (
    "WorldPosition, LanePosition, RoadPosition, RelativeLanePosition, RelativeRoadPosition, "
    "RelativeObjectPosition, RelativeWorldPosition, TrajectoryPosition"
)


class CurveReader(Protocol):
    """Reader of the trajectory in an element."""

    def read_curve(self, holder: Element, actor: int, timed: bool) -> Trajectory:
        """Return the trajectory."""


def read_place(
    position: Element,
    parameters: Parameters,
    roads: RoadMap,
    names: Sequence[str],
    curves: CurveReader | None = None,
) -> Place:
    """Read the element ``Position``; ``names`` are those of the entities, the ego last."""
    place = _read_kind(position.choice(), parameters, roads, names, curves)
    return replace(place, turned=place.turned or position.children[0].find("Orientation") is not None)


def _read_kind(
    one: Element, parameters: Parameters, roads: RoadMap, names: Sequence[str], curves: CurveReader | None
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
            heading, absolute = _read_orientation(one, parameters)
            return Place("shifted", number("dx"), number("dy"), heading, None, other, absolute)
        case "TrajectoryPosition" if curves is not None:
            heading, absolute = _read_orientation(one, parameters)
            curve = curves.read_curve(one.find("TrajectoryRef") or one, -1, False)
            return Place("curve", number("s"), number("t", 0.0), heading, absolute=absolute, curve=curve)
        case "LanePosition":
            begin, lane = _begin(one, parameters, roads), find_lane(one, "laneId", parameters, roads)
            heading, absolute = _read_orientation(one, parameters)
            station = parameters.shifted(number("s"), begin)
            return Place("lane", station, number("offset", 0.0), heading, lane, absolute=absolute)
        case "RoadPosition":
            station = parameters.shifted(number("s"), _begin(one, parameters, roads))
            heading, absolute = _read_orientation(one, parameters)
            return Place("road", station, number("t"), heading, absolute=absolute)
        case "RelativeLanePosition":
            other = find_entity(one, "entityRef", parameters, names)
            heading, absolute = _read_orientation(one, parameters)
            across = parameters.whole(one, "dLane")
            ahead = number("ds" if one.get("dsLane") is None else "dsLane")
            offset = number("offset", 0.0)
            return Place("beside", ahead, offset, heading, across, other, absolute)
        case "RelativeRoadPosition":
            other = find_entity(one, "entityRef", parameters, names)
            heading, absolute = _read_orientation(one, parameters)
            return Place("beside", number("ds"), number("dt"), heading, None, other, absolute)
        case "RelativeObjectPosition":
            other = find_entity(one, "entityRef", parameters, names)
            one.get("dz")
            heading, absolute = _read_orientation(one, parameters)
            return Place("ahead", number("dx"), number("dy"), heading, None, other, absolute)
    raise one.unknown(POSITIONS)


def find_entity(element: Element, name: str, parameters: Parameters, names: Sequence[str]) -> int:
    """Return the index of the entity that an attribute names."""
    text = parameters.text(element, name)
    if text not in names:
        raise element.error(f"there is no entity {text!r}", did_you_mean(text, names))
    return list(names).index(text)


def find_lane(element: Element, name: str, parameters: Parameters, roads: RoadMap) -> int:
    """Return the index of the lane whose id an attribute has."""
    lane = parameters.whole(element, name)
    if lane not in roads.lanes:
        known = ", ".join(map(str, sorted(roads.lanes)))
        what = "nobody drives on lane" if lane in roads.centres else "there is no lane"
        raise element.error(f"{what} {lane}", f"lanes of the road: {known}")
    return roads.lanes[lane]


def _begin(element: Element, parameters: Parameters, roads: RoadMap) -> float:
    road = parameters.text(element, "roadId")
    if road not in roads.begins:
        raise element.error(f"there is no road {road!r}", f"there are: {', '.join(roads.begins)}")
    return roads.begins[road]


def _read_orientation(position: Element, parameters: Parameters) -> tuple[Number, bool]:
    found = position.find("Orientation")
    if found is None:
        return parameters.constant(0.0), False
    for name in ("p", "r"):
        found.get(name)
    kind = found.get("type") or "absolute"
    if kind not in ("absolute", "relative"):
        raise found.error(f"type should be absolute or relative, found {kind!r}")
    return parameters.number(found, "h", 0.0), kind == "absolute"
