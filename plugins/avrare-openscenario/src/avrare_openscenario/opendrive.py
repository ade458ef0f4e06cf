"""Roads of OpenDRIVE files: straights, arcs and spirals in one line, with lanes of constant widths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.driving.reference_line import CurvedLine, Piece, PolygonalLine, ReferenceLine
from avrare.protocols import Floats
from avrare_openscenario.curves import go_on, polynomial
from avrare_openscenario.network import Connection, Network, RoadMap
from avrare_openscenario.road_lanes import KINDS, LaneStrip, Polynomial, evaluate, read_lanes, read_polynomial
from avrare_openscenario.xml_tree import Element, read_xml

_APART, _TURNED = 0.01, 1e-3
"""Most distance [m] and angle [rad] of a piece from the end of the one before it in an exact line."""
_MOST_APART, _MOST_BENT = 0.5, 0.2
"""The same of one that is read at all."""
_LONGEST = 1e6
"""Longest line of roads [m]."""
_MOST_TURNED = 100.0
"""Most angle that a spiral may turn by [rad]: more would be computed for hours."""
_STEP = 0.2
"""Distance of the points of a curve that is a polynomial [m]."""
_LIGHT = "light"
_RANKS = {"205": 0, "206": -1, "301": 2, "306": 2}
"""Rank by the sign of an incoming road, by the numbers of Germany's: yield, stop, right of way, priority."""


def read_opendrive(path: str) -> Network:
    """Read the roads of a file.

    Raises:
        UsageError: The file is no OpenDRIVE, or has curves that are not read.
    """
    top = read_xml(path, "OpenDRIVE")
    top.skip_children("header", "controller", "junction", "junctionGroup", "station")
    top.skip_everywhere("userData", "dataQuality")
    roads = top.list("road")
    if not roads:
        raise top.error("has no road")
    chains = _chains(roads)
    maps = tuple(read_chain(chain) for chain in chains)
    top.refuse_unread()
    network = Network(maps, top.notes())
    return replace(network, connections=_list_connections(top, chains, network))


def _list_connections(
    top: Element, chains: Sequence[Sequence[Element]], network: Network
) -> dict[tuple[int, int], list[Connection]]:
    connections: dict[tuple[int, int], list[Connection]] = {}
    junctions = {junction.attributes.get("id"): junction for junction in top.list("junction")}
    for chain, roads in zip(chains, network.maps, strict=True):
        for direction, road, side in ((1, chain[-1], "successor"), (-1, chain[0], "predecessor")):
            link = road.find("link")
            target = None if link is None else link.find(side)
            if target is None:
                continue
            name, ways = target.attributes.get("elementId", ""), list[Connection]()
            if target.attributes.get("elementType") == "junction":
                ways = _list_crossings(junctions[name], road, network) if name in junctions else []
            elif (other := network.find(name)) is not None:
                lanes = _lane_links(road, side, -1 if direction > 0 else 0)
                ways = [Connection(other, _find_direction(target), lanes)]
            leads = connections.setdefault((id(roads), direction), [])
            for way in ways:
                same = {lane: lane * way.direction * direction for lane in roads.lanes}
                leads.append(replace(way, lanes=way.lanes or same))
    return connections


def _list_crossings(junction: Element, road: Element, network: Network) -> list[Connection]:
    # Ways of a road through a junction.
    ways, signs = [], _list_signs(road)
    for way in junction.list("connection"):
        connecting = way.attributes.get("connectingRoad") or way.attributes.get("linkedRoad", "")
        other = network.find(connecting)
        if other is None or way.attributes.get("incomingRoad") != road.attributes["id"]:
            continue
        lanes = {int(pair.number("from")): int(pair.number("to")) for pair in way.list("laneLink")}
        ranks = [_RANKS[sign] for sign in signs if sign in _RANKS]
        for priority in junction.list("priority"):
            sides = (("high", 2), ("low", 0))
            ranks += [rank for side, rank in sides if priority.attributes.get(side) == connecting]
        ends = [begin for begin in other.begins.values() if begin > other.begins[connecting]]
        span = other.begins[connecting], min(ends, default=other.line.length)
        name, rank = junction.attributes.get("id", ""), min(ranks, default=1)
        ways.append(Connection(other, _find_direction(way), lanes, span, name, rank, _LIGHT in signs))
    return ways


def _find_direction(element: Element) -> int:
    # Direction in which a road is driven that is entered at the point of contact of a link.
    return 1 if element.attributes.get("contactPoint", "start") == "start" else -1


def _list_signs(road: Element) -> set[str]:
    block = road.find("signals")
    signals = () if block is None else block.list("signal")
    return {
        _LIGHT if signal.attributes.get("dynamic") == "yes" else signal.attributes.get("type", "")
        for signal in signals
    }


def _lane_links(road: Element, side: str, section: int) -> dict[int, int]:
    # Id of the lane that follows each, as the lanes of the last or first section say.
    block = road.child("lanes").list("laneSection")[section]
    links = {}
    for group in block.children:
        for lane in group.list("lane"):
            link = lane.find("link")
            after = None if link is None else link.find(side)
            if after is not None:
                links[int(lane.number("id"))] = int(after.number("id"))
    return links


def read_chain(chain: Sequence[Element]) -> RoadMap:
    """Return roads that follow one another in a single line.

    Raises:
        UsageError: They do not join smoothly, or their lanes differ.
    """
    begins, pieces, at, smooth = {}, [], 0.0, True
    points: list[Floats] = []
    start: tuple[float, float, float] | None = None
    before: CurvedLine | None = None
    for road in chain:
        begins[road.attribute("id")] = at
        for geometry in road.child("planView").list("geometry"):
            x, y, heading = (geometry.number(name) for name in ("x", "y", "hdg"))
            if geometry.number("length") == 0.0:
                geometry.skip()
                continue
            at += geometry.number("length")
            if at > _LONGEST:
                raise geometry.error(f"the road is longer than {_LONGEST / 1e3:g} km")
            if geometry.children and geometry.children[0].tag in ("paramPoly3", "poly3"):
                points.append(_sample_polynomial(geometry, x, y, heading))
                before = None
                continue
            apart = 0.0 if before is None else _find_gap(geometry, before, x, y, heading)
            start = start or (x, y, heading)
            pieces.append(_read_piece(geometry))
            before = CurvedLine((pieces[-1],), x, y, heading)
            piece = _sample_line(before)
            points.append(go_on(points, piece, len(piece), apart) if apart else piece)
            smooth &= apart == 0.0
    every = np.concatenate(points) if points else np.zeros((1, 2))
    if not (np.isfinite(every).all() and np.ptp(every, axis=0).any()):
        raise chain[0].error("has no geometry, or none of finite length")
    line: ReferenceLine = PolygonalLine(every)
    if start is not None and len(pieces) == len(points) and smooth:
        line = CurvedLine(tuple(pieces), *start)
    lanes = read_lanes(chain[0], at if len(chain) == 1 else chain[0].number("length"))
    for road in chain[1:]:
        if not _same_lanes(read_lanes(road, road.number("length")), lanes):
            raise road.error("joined roads need the same lanes of constant width", "give both the same ids")
    left = {road.get("rule") == "LHT" for road in chain} == {True}
    tilt = _read_tilt(chain, begins, at)
    for road in chain:
        road.skip_children("objects", "signals", "type", "surface", "railroad", "CRG")
        road.ignore("name", "length", "junction")
    return replace(_assemble(line, begins, lanes, left), tilt=tilt)


def _same_lanes(lanes: Sequence[LaneStrip], others: Sequence[LaneStrip]) -> bool:
    # Constant lanes of the same ids and borders.
    def describe(lane: LaneStrip) -> tuple[float, ...]:
        border = lane.border
        values = border.right[0], border.left[0], np.ptp(border.right), np.ptp(border.left)
        return lane.name, *np.round(values, 6)

    return [describe(lane) for lane in lanes] == [describe(lane) for lane in others] and not any(
        np.ptp(lane.border.right) or np.ptp(lane.border.left) for lane in lanes
    )


def _sample_line(piece: CurvedLine) -> Floats:
    stations = np.linspace(0.0, piece.length, max(2, 1 + int(np.ceil(piece.length / _STEP))))
    return np.stack(piece.frame(stations)[:2], axis=1)


def _sample_polynomial(geometry: Element, x: float, y: float, heading: float) -> Floats:
    shape, length = _read_shape(geometry)
    stations = np.linspace(0.0, length, max(2, 1 + int(np.ceil(length / _STEP))))
    if shape.tag == "poly3":
        along, across = stations, polynomial([shape.number(name) for name in "abcd"], stations)
    else:
        share = stations if shape.get("pRange") == "arcLength" else stations / length
        along, across = (
            polynomial([shape.number(f"{name}{axis}") for name in "abcd"], share) for axis in "UV"
        )
    cos, sin = math.cos(heading), math.sin(heading)
    return np.stack([x + cos * along - sin * across, y + sin * along + cos * across], axis=1)


def _read_tilt(chain: Sequence[Element], begins: dict[str, float], length: float) -> Floats | None:
    # Stations, slope, bank and change of the bank; None where the roads are flat.
    heights, banks = list[Polynomial](), list[Polynomial]()
    for road in chain:
        begin = begins[road.attribute("id")]
        for block, tag, records in (
            ("elevationProfile", "elevation", heights),
            ("lateralProfile", "superelevation", banks),
        ):
            records.append((begin, 0.0, 0.0, 0.0, 0.0))
            for profile in road.list(block):
                for record in profile.list(tag):
                    s, a, b, c, d = read_polynomial(record, "s")
                    records.append((begin + s, a, b, c, d))
                profile.skip()
                terms = [(child, name) for child in profile.children for name in "abcd" if child.get(name)]
                if any(child.number(name) for child, name in terms):
                    profile.note("vehicles drive as on a flat road")
    if not any(any(terms) for _, *terms in (*heights, *banks)):
        return None
    stations = np.linspace(0.0, length, max(2, 1 + math.ceil(length)))
    slopes, changes = ([(s, b, 2.0 * c, 3.0 * d, 0.0) for s, _, b, c, d in rows] for rows in (heights, banks))
    return np.stack([stations, *(evaluate(rows, stations) for rows in (slopes, banks, changes))])


def _chains(roads: Sequence[Element]) -> list[list[Element]]:
    # Roads that follow one another in the same direction; at a junction, a line ends.
    named: dict[str, Element] = {}
    for road in roads:
        if named.setdefault(road.attribute("id"), road) is not road:
            raise road.error(f"a second road {road.attribute('id')!r}", "give each an id of its own")
    following: dict[str, str] = {}
    for name, road in named.items():
        link = road.find("link")
        if link is not None:
            link.skip()
        successor = None if link is None else link.find("successor")
        target = {} if successor is None else successor.attributes
        if target.get("elementType") != "junction" and target.get("contactPoint", "start") == "start":
            following[name] = target.get("elementId", "")
    chains = []
    first = [name for name in named if name not in following.values()]
    waiting = dict.fromkeys([*first, *named])  # the others are rings
    while waiting:
        chain = [next(iter(waiting))]
        del waiting[chain[0]]
        while (after := following.get(chain[-1], "")) in waiting and _joins(named[chain[-1]], named[after]):
            chain.append(after)
            del waiting[after]
        chains.append([named[name] for name in chain])
    return chains


def _joins(road: Element, after: Element) -> bool:
    # Whether a road goes on smoothly in another one with the same lanes.
    before, following = (block.child("planView").list("geometry") for block in (road, after))
    if not (before and following):
        return False
    last, first = before[-1], following[0]
    try:
        end = CurvedLine((_read_piece(last),), *(last.number(name) for name in ("x", "y", "hdg")))
        apart, turned = _measure_joint(end, *(first.number(name) for name in ("x", "y", "hdg")))
        _read_piece(first)
        lanes = [read_lanes(block, block.number("length")) for block in (road, after)]
    except UsageError:
        return False
    return apart <= _APART and abs(turned) <= _TURNED and _same_lanes(*lanes)


def _read_shape(geometry: Element) -> tuple[Element, float]:
    geometry.get("s")
    shape, length = geometry.choice(), geometry.number("length")
    if length <= 0.0:
        raise geometry.error("the length should be above 0")
    return shape, length


def _read_piece(geometry: Element) -> Piece:
    shape, length = _read_shape(geometry)
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
    raise shape.error("is not read", "known here: line, arc, spiral")


def _measure_joint(before: CurvedLine, x: float, y: float, heading: float) -> tuple[float, float]:
    end_x, end_y, end, _ = (value.item() for value in before.frame(np.array([before.length])))
    return math.hypot(x - end_x, y - end_y), math.remainder(heading - end, 2.0 * math.pi)


def _find_gap(geometry: Element, before: CurvedLine, x: float, y: float, heading: float) -> float:
    # How far a piece is apart from the one before it, 0 where it goes on smoothly.
    apart, turned = _measure_joint(before, x, y, heading)
    if apart <= _APART and abs(turned) <= _TURNED:
        return 0.0
    text = f"begins {apart:.3g} m and {turned:.3g} rad from the end of the piece before it"
    if apart > _MOST_APART or abs(turned) > _MOST_BENT:
        raise geometry.error(text, "pieces must join smoothly")
    geometry.note(text)
    return apart or 1e-9


def _assemble(line: ReferenceLine, begins: dict[str, float], lanes: list[LaneStrip], left: bool) -> RoadMap:
    driven = [lane for lane in lanes if lane.kind in KINDS]
    kinds = [KINDS[lane.kind] for lane in driven]
    widths = [float(np.median(lane.border.left - lane.border.right)) for lane in driven]
    centres = {lane.name: float(np.median(0.5 * (lane.border.right + lane.border.left))) for lane in lanes}
    varies = any(
        np.ptp(lane.border.right) or np.ptp(lane.border.left) or len(lane.border.stations) > 2
        for lane in driven
    )
    apart = varies or any(
        abs(lane.border.left[0] - other.border.right[0]) > 1e-6 for lane, other in pairwise(driven)
    )
    apart |= max(widths, default=0.0) - min(widths, default=0.0) > 1e-6
    tip = np.array([0.0, line.length])
    bent = not isinstance(line, CurvedLine) or any(
        piece.curvature or piece.end_curvature for piece in line.pieces
    )
    own_frame = CurvedLine(line.pieces) if isinstance(line, CurvedLine) else line

    def list_indices(marks: list[bool]) -> tuple[int, ...]:
        return tuple(index for index, marked in enumerate(marks) if marked)

    road = Road(
        tuple(centres[lane.name] for lane in driven),
        float(np.median(widths)) if widths else 0.0,
        list_indices([kind == "ramp" for kind in kinds]),
        0.0,
        line.length,
        own_frame if bent else None,
        tuple(lane.border if varies else replace(lane.border, stations=tip) for lane in driven if apart),
        list_indices([kind == "shoulder" for kind in kinds]),
        list_indices([(lane.name > 0) != left for lane in driven]),
        list_indices([lane.broad for lane in driven]),
    )
    closed = line.length > 1.0 and bool(np.hypot(*np.diff(line.frame(tip)[:2])) < _APART)
    indices = {lane.name: index for index, lane in enumerate(driven)}
    return RoadMap(road, line, begins, indices, centres, closed)
