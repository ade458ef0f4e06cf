"""Roads of OpenDRIVE files: straights, arcs and spirals in one line, with lanes of constant widths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from avrare.driving import Road
from avrare.driving.reference_line import CurvedLine, Piece, ReferenceLine
from avrare.driving.values import Lane
from avrare.protocols import Floats
from avrare_single_track.openscenario.xml_tree import Element, read_xml

_APART = 0.01
"""Most distance of a piece from the end of the one before it [m]."""
_TURNED = 1e-3
"""Most angle between them [rad]."""
_MOST_TURNED = 100.0
"""Most angle that a spiral may turn by [rad]: more would be computed for hours."""
_KINDS = {
    "driving": "driving",
    "entry": "ramp",
    "onRamp": "ramp",
    "exit": "driving",
    "offRamp": "driving",
    "connectingRamp": "driving",
    "shoulder": "shoulder",
    "stop": "shoulder",
}
"""Types of lanes that are lanes of the road; others only take their width."""
_IDLE = ("speed", "material", "access", "height", "rule")
"""Elements of a lane that change nothing."""


@dataclass(frozen=True)
class RoadMap:
    """Road of a file, with the names by which the file calls its parts.

    Attributes:
        road: Road.
        line: Reference line in the plane of the file, also where the road is straight.
        begins: Station at which each road of the file begins [m].
        lanes: Index of each lane, by its id.
        centres: y of each lane's centre, by its id, for lanes that nobody drives on as well [m].
        notes: What of its file is left out, with its places.
    """

    road: Road
    line: ReferenceLine
    begins: Mapping[str, float]
    lanes: Mapping[int, int]
    centres: Mapping[int, float]
    notes: tuple[str, ...] = ()

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


def read_opendrive(path: str) -> RoadMap:
    """Read the roads of a file, which must follow one another in a single line.

    Raises:
        UsageError: The file is no OpenDRIVE, or has what is not read: junctions, other curves, lanes that
            begin, end or change their widths.
    """
    top = read_xml(path, "OpenDRIVE")
    top.skip_children("header")
    top.skip_everywhere("userData", "dataQuality")
    chain = _chain(top, top.list("road"))
    if junctions := top.list("junction"):
        raise junctions[0].error("is not read", "give a file whose roads follow one another")
    begins, pieces, at = {}, [], 0.0
    start: tuple[float, float, float] | None = None
    before: CurvedLine | None = None
    for road in chain:
        begins[road.attribute("id")] = at
        for geometry in road.child("planView").list("geometry"):
            x, y, heading = (geometry.number(name) for name in ("x", "y", "hdg"))
            if before is not None:
                _check_joint(geometry, before, x, y, heading)
            start = start or (x, y, heading)
            pieces.append(_read_piece(geometry))
            before = CurvedLine((pieces[-1],), x, y, heading)
            at += before.length
    if start is None:
        raise top.error("has no geometry")
    line = CurvedLine(tuple(pieces), *start)
    lanes = _read_lanes(chain[0])
    for road in chain[1:]:
        if _read_lanes(road) != lanes:
            raise road.error("its lanes differ from those of the road before it", "lanes must go on")
    for road in chain:
        for profile in (*road.list("elevationProfile"), *road.list("lateralProfile")):
            _pass_over_profile(profile)
        road.skip_children("objects", "signals", "type", "surface")
        for name in ("name", "length", "junction"):
            road.get(name)
        if road.get("rule") == "LHT":
            raise road.error("traffic on the left is not read")
    top.refuse_unread()
    return replace(_assemble(line, begins, lanes), notes=tuple(top.notes()))


def _pass_over_profile(profile: Element) -> None:
    flat = all(
        child.attributes.get(name, "0").strip("+-0.eE") == ""
        for child in profile.children
        for name in "abcd"
    )
    if flat:
        profile.skip()
    else:
        profile.pass_over("the road is read as flat")


def _chain(top: Element, roads: list[Element]) -> list[Element]:
    # Roads in the order in which they follow one another.
    if not roads:
        raise top.error("has no road")
    named = {road.attribute("id"): road for road in roads}
    following = {}
    for road in roads:
        link = road.find("link")
        for side in ("predecessor", "successor"):
            next_one = link.find(side) if link is not None else None
            if next_one is None:
                continue
            kind, name = next_one.get("elementType"), next_one.attribute("elementId")
            if kind != "road" or name not in named:
                raise next_one.error(f"the road is not joined to another road but to {kind} {name!r}")
            contact = "start" if side == "successor" else "end"
            if next_one.get("contactPoint") != contact:
                raise next_one.error("the roads that it joins have opposite directions")
            if side == "successor":
                following[road.attribute("id")] = name
    first = [name for name in named if name not in following.values()]
    if len(first) != 1:
        raise roads[0].error(f"{len(roads)} roads do not follow one another in a single line")
    order = first
    while order[-1] in following and len(order) <= len(roads):
        order.append(following[order[-1]])
    if len(order) != len(roads):
        raise roads[0].error(f"{len(roads)} roads do not follow one another in a single line")
    return [named[name] for name in order]


def _read_piece(geometry: Element) -> Piece:
    geometry.get("s")
    shape, length = geometry.choice(), geometry.number("length")
    if length <= 0.0:
        raise geometry.error("the length should be above 0")
    match shape.tag:
        case "line":
            return Piece(length)
        case "arc":
            curvature = shape.number("curvature")
            return Piece(length, curvature, curvature)
        case "spiral":
            ends = shape.number("curvStart"), shape.number("curvEnd")
            if max(map(abs, ends)) * length > _MOST_TURNED:
                raise shape.error(f"turns by more than {_MOST_TURNED:g} rad: no road does")
            return Piece(length, *ends)
    raise shape.unknown("line, arc, spiral")


def _check_joint(geometry: Element, before: CurvedLine, x: float, y: float, heading: float) -> None:
    end_x, end_y, end, _ = (part.item() for part in before.frame(np.array([before.length])))
    apart, turned = math.hypot(x - end_x, y - end_y), math.remainder(heading - end, 2.0 * math.pi)
    if apart > _APART or abs(turned) > _TURNED:
        text = f"begins {apart:.3g} m and {turned:.3g} rad from the end of the piece before it"
        raise geometry.error(text, "pieces must join smoothly")


def _read_lanes(road: Element) -> list[tuple[int, str, float, float, bool]]:
    # Id, kind, y of the right border, width and a broad left marking of each lane, from right to left.
    block = road.child("lanes")
    offsets = {_constant(one) for one in block.list("laneOffset")} or {0.0}
    sections = block.list("laneSection")
    if len(offsets) > 1 or not sections:
        raise block.error("the offset of the lanes changes" if sections else "has no laneSection")
    found = [_read_section(section, offsets.copy().pop()) for section in sections]
    for section, lanes in zip(sections, found, strict=True):
        if lanes != found[0]:
            raise section.error("its lanes differ from those before it", "lanes must have constant widths")
    return found[0]


def _read_section(section: Element, offset: float) -> list[tuple[int, str, float, float, bool]]:
    section.get("s")
    section.get("singleSide")
    lanes = {}
    for side in ("left", "center", "right"):
        for block in section.list(side):
            for lane in block.list("lane"):
                lanes[int(lane.number("id"))] = lane
    count = sum(
        len(block.list("lane")) for side in ("left", "center", "right") for block in section.list(side)
    )
    if count != len(lanes) or 0 not in lanes or len(lanes) != max(lanes) - min(lanes) + 1:
        raise section.error("the ids of its lanes do not count from 0 at the centre without gaps")
    widths = {name: _lane_width(lane) for name, lane in lanes.items() if name}
    marks = {name: _is_broad(lane) for name, lane in lanes.items()}
    lanes[0].get("type")
    found, right = [], offset - sum(width for name, width in widths.items() if name < 0)
    for name in sorted(widths):
        broad = marks[name if name > 0 else name + 1]
        found.append((name, lanes[name].attribute("type"), right, widths[name], broad))
        right += widths[name]
    return found


def _lane_width(lane: Element) -> float:
    lane.get("level")
    lane.skip_children("link", *_IDLE)
    widths = {_constant(one) for one in lane.list("width")}
    if len(widths) != 1:
        raise lane.error("its width changes" if widths else "has no width", "widths must be constant")
    return widths.pop()


def _is_broad(lane: Element) -> bool:
    for name in ("level", "type", "direction", "advisory", "dynamicLaneDirection"):
        lane.get(name)
    marks = lane.list("roadMark")
    weights = {mark.attributes.get("weight") for mark in marks}
    lane.skip_children("roadMark", "link", *_IDLE)
    if lane.attribute("id") == "0":
        lane.skip_children("width", "border")
    return weights == {"bold"}


def _constant(polynomial: Element) -> float:
    for name in ("s", "sOffset"):
        polynomial.get(name)
    if any(polynomial.number(name) for name in "bcd"):
        raise polynomial.error("changes along the road", "only constant widths and offsets are read")
    return polynomial.number("a")


def _assemble(
    line: CurvedLine, begins: dict[str, float], lanes: list[tuple[int, str, float, float, bool]]
) -> RoadMap:
    kept = [one for one in lanes if one[1] in _KINDS]
    kinds = [_KINDS[kind] for _, kind, _, _, _ in kept]
    widths = [width for _, _, _, width, _ in kept]
    centres = [right + 0.5 * width for _, _, right, width, _ in kept]
    apart = any(abs(one[2] + one[3] - other[2]) > 1e-6 for one, other in pairwise(kept)) or (
        max(widths, default=0.0) - min(widths, default=0.0) > 1e-6
    )
    ends = np.array([0.0, line.length])
    bent = any(piece.curvature or piece.end_curvature for piece in line.pieces)

    def chosen(test: list[bool]) -> tuple[int, ...]:
        return tuple(index for index, yes in enumerate(test) if yes)

    road = Road(
        tuple(centres),
        float(np.median(widths)) if widths else 0.0,
        chosen([kind == "ramp" for kind in kinds]),
        0.0,
        line.length,
        CurvedLine(line.pieces) if bent else None,
        tuple(Lane(ends, np.full(2, right), np.full(2, right + width)) for _, _, right, width, _ in kept)
        if apart
        else (),
        chosen([kind == "shoulder" for kind in kinds]),
        chosen([name > 0 for name, _, _, _, _ in kept]),
        chosen([broad for _, _, _, _, broad in kept]),
    )
    return RoadMap(
        road,
        line,
        begins,
        {name: index for index, (name, _, _, _, _) in enumerate(kept)},
        {name: right + 0.5 * width for name, _, right, width, _ in lanes},
    )
