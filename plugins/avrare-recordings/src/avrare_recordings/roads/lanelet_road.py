"""Road of a lanelet network along the way of one vehicle: a reference line, and lanes that begin and end.

The reference line runs along the centres of successive lanelets on which the vehicle drives, or beside which
it does after a change of lanes. Lanelets that can be reached from these and run along the line, either way,
become lanes; those that cross it or turn off do not. Only attributes of lanelets of commonroad-io are read,
so that any object with these will do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Lane, Road
from avrare.driving.reference_line import PolygonalLine, ReferenceLine
from avrare.protocols import Bools, Floats

if TYPE_CHECKING:
    from commonroad.scenario.lanelet import Lanelet

ASIDE = 30.0
"""Largest distance of a part of the road from the reference line [m]."""


@dataclass(frozen=True)
class _Section:
    # an accepted lanelet in the frame of the line; right and left are those of the line
    name: int
    right: Floats
    left: Floats
    opposing: bool
    kind: str
    source: Lanelet


def find_road(path: str, lanelets: Sequence[Lanelet], positions: Floats, headings: Floats) -> Road:
    """Return the road along a drive.

    Args:
        path: File, for messages.
        lanelets: The network.
        positions: (T, 2) places of the vehicle in the plane [m].
        headings: (T,) its headings [rad].

    Raises:
        UsageError: The vehicle drives on no lanelet, or on damaged ones.
    """
    by_id = {int(lanelet.lanelet_id): lanelet for lanelet in lanelets}
    names = find_path(path, lanelets, positions, headings)
    line = _join_centres([by_id[name] for name in names])
    sections = _collect_sections(by_id, names, line)
    chains = [chain for way in (False, True) for chain in _chain(sections, names, way)]
    if not chains:
        text = f"{path}: no border of the lanelets that the ego drives on runs along their middle"
        raise UsageError(text, "mend the lanelets, or give the lanes yourself")
    return _assemble(line, sorted(chains, key=_mean_offset))


def find_path(path: str, lanelets: Sequence[Lanelet], positions: Floats, headings: Floats) -> list[int]:
    """Return the successive lanelets of a drive; the arguments and the error are those of ``find_road``."""
    by_id = {int(lanelet.lanelet_id): lanelet for lanelet in lanelets}
    used = _count_samples(by_id, positions, headings)
    if not used:
        text = f"{path}: the ego drives on no lanelet, or against all that it touches"
        raise UsageError(text, "choose another ego, or give the lanes yourself, in the file's coordinates")
    return _find_path(by_id, used)


def _count_samples(by_id: Mapping[int, Lanelet], positions: Floats, headings: Floats) -> dict[int, int]:
    # lanelet -> samples in it that go its way
    direction = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    counts = {}
    for name, lanelet in by_id.items():
        outline = np.concatenate([lanelet.left_vertices, lanelet.right_vertices[::-1]])
        inside = is_inside(outline[:, :2], positions)
        if inside.any():
            centre = np.asarray(lanelet.center_vertices)[:, :2]
            s, _ = (line := PolygonalLine(centre)).to_road(*positions[inside].T)
            angle = line.heading(s)
            along = direction[inside] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            if count := int((along.sum(axis=1) > 0.5).sum()):  # within 60 degrees of the lanelet
                counts[name] = count
    return counts


def is_inside(outline: Floats, points: Floats) -> Bools:
    """Return a mask (K,) of the points (K, 2) inside an outline (M, 2), by the even-odd rule."""
    inside = np.zeros(len(points), dtype=np.bool_)
    near = ((points >= outline.min(axis=0)) & (points <= outline.max(axis=0))).all(axis=1)
    if near.any():
        x, y = points[near, None, 0], points[near, None, 1]
        (x0, y0), (x1, y1) = outline.T, np.roll(outline, -1, axis=0).T
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
        inside[near] = (((y0 > y) != (y1 > y)) & (x < crossing)).sum(axis=1) % 2 == 1
    return inside


def _find_path(by_id: Mapping[int, Lanelet], used: Mapping[int, int]) -> list[int]:
    # successive lanelets beside which, or on which, the vehicle is for most samples
    neighbours = {name: find_neighbours(by_id, name) for name in by_id}

    def weight(name: int) -> tuple[int, int]:
        return sum(used.get(other, 0) for other in neighbours[name]), used.get(name, 0)

    def total(names: Sequence[int]) -> tuple[int, int]:
        every = {other for name in names for other in neighbours[name]}
        return sum(used.get(other, 0) for other in every), sum(used.get(name, 0) for name in names)

    paths = []
    for start in sorted(used):
        path = [start]
        for links, at in (("successor", -1), ("predecessor", 0)):
            while choices := [name for name in _links(by_id, path[at], links) if name not in path]:
                here = by_id[path[at]]
                best = max(choices, key=lambda name: (*weight(name), _straightness(here, by_id[name]), -name))
                path.insert(len(path) if at else 0, best)
        paths.append(path)
    return max(paths, key=lambda path: (*total(path), -path[0]))


def find_neighbours(by_id: Mapping[int, Lanelet], name: int) -> set[int]:
    """Return a lanelet and all of the same direction beside it."""
    neighbours = {name}
    for side in ("left", "right"):
        at = name
        while True:
            other = _neighbour(by_id, at, side)
            if other is None or other in neighbours or not getattr(by_id[at], f"adj_{side}_same_direction"):
                break
            neighbours.add(at := other)
    return neighbours


def _neighbour(by_id: Mapping[int, Lanelet], name: int, side: str) -> int | None:
    other = getattr(by_id[name], f"adj_{side}")
    return int(other) if other is not None and other in by_id else None


def _links(by_id: Mapping[int, Lanelet], name: int, kind: str) -> list[int]:
    return [int(other) for other in getattr(by_id[name], kind) or () if other in by_id]


def _straightness(first: Lanelet, second: Lanelet) -> float:
    # minus the angle between the directions of two lanelets where they are nearest to each other
    ends = [np.asarray(lanelet.center_vertices)[:, :2] for lanelet in (first, second)]
    forward = np.hypot(*(ends[0][-1] - ends[1][0])) <= np.hypot(*(ends[0][0] - ends[1][-1]))
    at = (-1, 0) if forward else (0, -1)
    steps = [np.diff(points, axis=0)[index] for points, index in zip(ends, at, strict=True)]
    turned = np.arctan2(steps[1][1], steps[1][0]) - np.arctan2(steps[0][1], steps[0][0])
    return -float(abs(np.remainder(turned + np.pi, 2.0 * np.pi) - np.pi))


def _join_centres(lanelets: Iterable[Lanelet]) -> PolygonalLine:
    return PolygonalLine(np.concatenate([np.asarray(lanelet.center_vertices)[:, :2] for lanelet in lanelets]))


def _collect_sections(
    by_id: Mapping[int, Lanelet], names: Sequence[int], line: ReferenceLine
) -> dict[int, _Section]:
    # from lanelet to lanelet that touches it, as far as they run along the line
    sections: dict[int, _Section] = {}
    pending, seen = list(names), set(names)
    while pending:
        name = pending.pop()
        section = _make_section(name, by_id[name], line)
        if section is None:
            continue
        sections[name] = section
        side_lanelets = (_neighbour(by_id, name, side) for side in ("left", "right"))
        linked = (_links(by_id, name, kind) for kind in ("successor", "predecessor"))
        near = [other for other in side_lanelets if other is not None] + [
            other for several in linked for other in several
        ]
        pending += [other for other in near if other not in seen]
        seen.update(near)
    return sections


def _make_section(name: int, lanelet: Lanelet, line: ReferenceLine) -> _Section | None:
    borders = []
    for vertices in (lanelet.right_vertices, lanelet.left_vertices):
        border = np.stack(line.to_road(*np.asarray(vertices)[:, :2].T), axis=1)
        length = np.hypot(*np.diff(np.asarray(vertices)[:, :2], axis=0).T).sum()
        advance = border[-1, 0] - border[0, 0]
        if not (np.isfinite(border).all() and np.abs(border[:, 1]).max() <= ASIDE):
            return None
        if abs(advance) < 0.8 * length:  # it turns away, as at a crossing
            return None
        borders.append(border)
    opposing = bool(borders[0][-1, 0] < borders[0][0, 0])
    right, left = (border[::-1] for border in reversed(borders)) if opposing else borders
    kinds = {str(kind.value) for kind in lanelet.lanelet_type or ()}
    kind = next((lanelet_kind for lanelet_kind in ("accessRamp", "shoulder") if lanelet_kind in kinds), "")
    return _Section(name, right, left, opposing, kind, lanelet)


def _chain(sections: Mapping[int, _Section], path: Sequence[int], opposing: bool) -> list[list[_Section]]:
    # one after another, in the direction of the line; a merge or a fork continues where it is straightest
    same_way = {name: section for name, section in sections.items() if section.opposing == opposing}
    pairs = [
        (section.name, other)
        for section in same_way.values()
        for other in map(int, section.source.successor or ())
        if other in same_way
        and same_way[other].kind == section.kind
        and _follows(section, same_way[other], opposing)
    ]

    def rank(pair: tuple[int, int]) -> tuple[bool, float]:
        on_path = pair[0] in path and pair[1] in path
        return on_path, _straightness(same_way[pair[0]].source, same_way[pair[1]].source)

    following: dict[int, int] = {}
    for before, after in sorted(pairs, key=rank, reverse=True):
        if before not in following and after not in following.values():
            following[before] = after
    chains = []
    for first in sorted(set(same_way) - set(following.values())):
        chain = [first]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        chains.append([same_way[name] for name in (reversed(chain) if opposing else chain)])
    return chains


def _follows(before: _Section, after: _Section, opposing: bool) -> bool:
    # on a ring the last one does not
    advance = after.right[0, 0] - before.right[0, 0]
    return bool(advance < 0.0 if opposing else advance > 0.0)


def _mean_offset(chain: Sequence[_Section]) -> float:
    return float(
        np.mean([border[:, 1].mean() for section in chain for border in (section.right, section.left)])
    )


def _assemble(line: ReferenceLine, chains: Sequence[Sequence[_Section]]) -> Road:
    lanes = tuple(_make_lane(chain) for chain in chains)
    lane_of = {section.name: index for index, chain in enumerate(chains) for section in chain}
    centres = tuple(round(float(np.median(0.5 * (lane.right + lane.left))), 6) for lane in lanes)
    widths = np.concatenate([lane.left - lane.right for lane in lanes])
    kinds = [chain[0].kind for chain in chains]
    return Road(
        centres,
        round(float(np.median(widths)), 6),
        tuple(index for index, kind in enumerate(kinds) if kind == "accessRamp"),
        float(min(lane.stations[0] for lane in lanes)),
        float(max(lane.stations[-1] for lane in lanes)),
        line,
        lanes,
        tuple(index for index, kind in enumerate(kinds) if kind == "shoulder"),
        tuple(index for index, chain in enumerate(chains) if chain[0].opposing),
        tuple(sorted(_find_broad_markings(chains, lane_of))),
    )


def _make_lane(chain: Sequence[_Section]) -> Lane:
    borders = [np.concatenate([getattr(section, side) for section in chain]) for side in ("right", "left")]
    ascending = [np.maximum.accumulate(border[:, 0]) for border in borders]
    begin, end = (float(np.mean([s[at] for s in ascending])) for at in (0, -1))
    stations = np.unique(np.concatenate([[begin, end], *ascending]))
    stations = stations[(stations >= begin) & (stations <= end)]
    right, left = (np.interp(stations, s, border[:, 1]) for s, border in zip(ascending, borders, strict=True))
    return Lane(stations, right, np.maximum(left, right))


def _find_broad_markings(chains: Sequence[Sequence[_Section]], lane_of: Mapping[int, int]) -> set[int]:
    # lanes whose left border is broad, by their own marking or by that of the lane on their left
    broad = set()
    for index, chain in enumerate(chains):
        for section in chain:
            if section.opposing:
                continue
            if is_broad(section.source, "left"):
                broad.add(index)
            neighbour = section.source.adj_right
            if is_broad(section.source, "right") and neighbour is not None and neighbour in lane_of:
                broad.add(lane_of[int(neighbour)])
    return broad


def is_broad(lanelet: Lanelet, side: str) -> bool:
    """Return whether the marking of a lanelet's side is broad."""
    marking = getattr(lanelet, f"line_marking_{side}_vertices")
    return str(marking.value) in ("broad_dashed", "broad_solid")
