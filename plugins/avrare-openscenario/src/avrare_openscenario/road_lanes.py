"""Lanes of an OpenDRIVE road: constant ones, or borders that change along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.driving.values import Lane
from avrare.protocols import Floats
from avrare_openscenario.curves import polynomial
from avrare_openscenario.xml_tree import Element

_DRIVEN = ("driving", "bidirectional", "bus", "taxi", "HOV", "parking")
_LEAVING = ("exit", "mwyExit", "offRamp", "connectingRamp")
KINDS = {
    **dict.fromkeys((*_DRIVEN, *_LEAVING), "driving"),
    **dict.fromkeys(("entry", "mwyEntry", "onRamp"), "ramp"),
    **dict.fromkeys(("shoulder", "stop"), "shoulder"),
}
"""Types of lanes that are lanes of the road; others only take their width."""
_IDLE = ("speed", "material", "access", "height", "rule", "visibility")
"""Elements of a lane that change nothing."""
_PLAIN = ("level", "type", "direction", "advisory", "dynamicLaneDirection", "dynamicLaneType", "roadWorks")
"""Attributes of a lane that change nothing."""
_LONGEST = 1e6
"""Longest road [m]."""
_STEP = 1.0
"""Distance of the points of a border [m]."""
Polynomial = tuple[float, float, float, float, float]
"""Begin of its validity, and four coefficients."""


@dataclass(frozen=True)
class LaneStrip:
    """Lane of a whole road.

    Attributes:
        name: Its id.
        kind: Its type.
        border: Its borders.
        broad: Whether its left marking is broad.
    """

    name: int
    kind: str
    border: Lane
    broad: bool


@dataclass(frozen=True)
class _Lane:
    kind: str
    widths: list[Polynomial]  # or places of its outer border
    broad: bool
    bordered: bool


@dataclass(frozen=True)
class _Section:
    begin: float
    lanes: dict[int, _Lane]


def read_lanes(road: Element, length: float) -> list[LaneStrip]:
    """Return the lanes of a road, from right to left.

    Raises:
        UsageError: It has no section, or ids have gaps.
    """
    block, length = road.child("lanes"), min(length, _LONGEST)
    offsets = [read_polynomial(record, "s") for record in block.list("laneOffset")] or [(0.0,) * 5]
    sections = [_read_section(record) for record in block.list("laneSection")]
    if not sections:
        raise block.error("has no laneSection")
    ends = [*(min(section.begin, length) for section in sections[1:]), length]
    strips: dict[int, list[list[Floats]]] = {}
    kinds: dict[int, tuple[str, bool]] = {}
    constant = len(offsets) == 1 and not any(offsets[0][2:])
    for section, end in zip(sections, ends, strict=True):
        if end <= section.begin:
            continue
        fixed = constant and all(
            len(lane.widths) == 1 and not any(lane.widths[0][2:]) for lane in section.lanes.values()
        )
        count = 2 if fixed else max(2, 1 + int(np.ceil((end - section.begin) / _STEP)))
        stations = np.linspace(section.begin, end, count)
        with np.errstate(over="ignore", invalid="ignore"):
            borders = _list_borders(section, evaluate(offsets, stations), stations - section.begin)
        for name, (right, left) in borders.items():
            pieces = strips.setdefault(name, [])
            pieces.append([stations, right, left])
            kinds.setdefault(name, (section.lanes[name].kind, section.lanes[name].broad))
    if not all(np.isfinite(row).all() for pieces in strips.values() for piece in pieces for row in piece):
        raise block.error("its lanes have no finite widths")
    return [LaneStrip(name, kinds[name][0], _join(strips[name]), kinds[name][1]) for name in sorted(strips)]


def _list_borders(section: _Section, offset: Floats, along: Floats) -> dict[int, tuple[Floats, Floats]]:
    borders: dict[int, tuple[Floats, Floats]] = {}
    for side in (-1, 1):
        inner = offset
        for name in sorted((name for name in section.lanes if name * side > 0), key=abs):
            lane = section.lanes[name]
            place = evaluate(lane.widths, along)
            outer = offset + place if lane.bordered else inner + side * place
            borders[name] = (outer, inner) if side < 0 else (inner, outer)
            inner = outer
    return borders


def _join(pieces: Sequence[Sequence[Floats]]) -> Lane:
    # Pieces of one id that follow one another; of several runs the longest.
    runs: list[list[Sequence[Floats]]] = []
    for piece in pieces:
        if runs and runs[-1][-1][0][-1] == piece[0][0]:
            runs[-1].append(piece)
        else:
            runs.append([piece])
    longest = max(runs, key=lambda run: float(run[-1][0][-1] - run[0][0][0]))
    stations, right, left = (np.concatenate([piece[axis] for piece in longest]) for axis in range(3))
    inner = len(stations) > 2 and bool(np.ptp(right) == 0.0 and np.ptp(left) == 0.0)
    points = [0, -1] if inner else slice(None)
    return Lane(stations[points], right[points], left[points])


def _read_section(section: Element) -> _Section:
    section.get("singleSide")
    lanes: dict[int, Element] = {}
    count = 0
    for side in ("left", "center", "right"):
        for block in section.list(side):
            for lane in block.list("lane"):
                lanes[int(lane.number("id"))] = lane
                count += 1
    ids = {0, *lanes}
    if count != len(lanes) or len(ids) != max(ids) - min(ids) + 1:
        raise section.error("the ids of its lanes do not count from 0 at the centre without gaps")
    marks = {name: _is_broad(lane) for name, lane in lanes.items()}
    read = {}
    for name, lane in lanes.items():
        if name == 0:
            continue
        widths = [read_polynomial(record, "sOffset") for record in lane.list("width")]
        borders = [read_polynomial(record, "sOffset") for record in lane.list("border")]
        if not (widths or borders):
            lane.note("has no width")
        broad = marks.get(name if name > 0 else name + 1, False)
        values = sorted(widths or borders or [(0.0,) * 5])
        read[name] = _Lane(lane.attribute("type"), values, broad, bool(borders and not widths))
    return _Section(section.number("s") if section.get("s") is not None else 0.0, read)


def _is_broad(lane: Element) -> bool:
    lane.ignore(*_PLAIN)
    weights = {mark.attributes.get("weight") for mark in lane.list("roadMark")}
    lane.skip_children("roadMark", "link", *_IDLE)
    if lane.number("id") == 0:
        lane.skip_children("width", "border")
    return weights == {"bold"}


def read_polynomial(element: Element, begin: str) -> Polynomial:
    """Read a polynomial, whose begin an attribute gives."""
    first = element.number(begin) if element.get(begin) is not None else 0.0
    a, b, c, d = (element.number(name) for name in "abcd")
    return first, a, b, c, d


def evaluate(records: Sequence[Polynomial], s: Floats) -> Floats:
    """Return the values of polynomials that follow one another, at stations."""
    table = np.array(records)
    index = np.clip(np.searchsorted(table[:, 0], s + 1e-9, side="right") - 1, 0, None)
    begin, a, b, c, d = table[index].T
    return polynomial((a, b, c, d), s - begin)
