"""CommonRoad scenes on generated roads: bends, merges, lanes of varying width, opposing lanes, crossings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from avrare.driving.reference_line import CurvedLine, Piece, ReferenceLine

STRAIGHT = CurvedLine((Piece(300.0),))
BEND = CurvedLine((Piece(60.0), Piece(40.0, 0.0, 1 / 150), Piece(120.0, 1 / 150, 1 / 150), Piece(80.0)))


@dataclass
class Section:
    """A lanelet between two borders along a line."""

    name: int
    right: np.ndarray
    left: np.ndarray
    kind: str = "mainCarriageWay"
    successors: list[int] = field(default_factory=list)
    predecessors: list[int] = field(default_factory=list)
    beside: dict[str, tuple[int, bool]] = field(default_factory=dict)
    markings: dict[str, str] = field(default_factory=dict)


@dataclass
class Car:
    """A vehicle by station and offset at each step."""

    name: int
    s: np.ndarray
    d: np.ndarray
    speed: np.ndarray
    length: float = 4.5
    width: float = 1.8
    opposing: bool = False


def constant(value: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda s: np.full_like(s, value)


def section(
    line: ReferenceLine, name: int, begin: float, end: float, right, left, opposing=False, **more
) -> Section:
    """Return a lanelet between two stations and two offsets (numbers or functions of the station)."""
    s = np.linspace(begin, end, max(2, int((end - begin) / 4.0) + 1))
    borders = [
        np.stack(line.to_plane(s, border(s) if callable(border) else np.full_like(s, border)), axis=1)
        for border in (right, left)
    ]
    if opposing:
        borders = [border[::-1] for border in borders[::-1]]
    return Section(name, *borders, **more)


def join(sections: Sequence[Section], *names: int) -> None:
    """Make each named lanelet the successor of the one before."""
    by = {one.name: one for one in sections}
    for before, after in pairwise(names):
        by[before].successors.append(after)
        by[after].predecessors.append(before)


def neighbours(sections: Sequence[Section], right: int, left: int, same: bool = True) -> None:
    """Put one lanelet on the left of another."""
    by = {one.name: one for one in sections}
    by[right].beside["Left"] = left, same
    by[left].beside["Right" if same else "Left"] = right, same


def car(line: ReferenceLine, name: int, s: float, d, speed: float, steps: int = 40, **more) -> Car:
    """Return a car that keeps its speed at an offset, a number or one for each step."""
    offset = np.broadcast_to(np.asarray(d, dtype=float), (steps,))
    pace = speed / (1.0 - line.curvature(np.array([s])) * offset)
    return Car(name, s + np.cumsum(pace) * 0.1 - pace[0] * 0.1, offset, np.full(steps, abs(speed)), **more)


def carriageway(
    line: ReferenceLine, lanes: int, sections: int = 3, width=3.5, length: float | None = None
) -> list[Section]:
    """Return parallel lanes in a few sections, lane k between k and k + 1 widths."""
    ends = np.linspace(0.0, line.length if length is None else length, sections + 1)
    found = []
    for k in range(lanes):
        for i in range(sections):
            border = [(lambda s, k=j: k * width(s)) if callable(width) else j * width for j in (k, k + 1)]
            found.append(section(line, 100 * (k + 1) + i, ends[i], ends[i + 1], *border))
    for k in range(lanes):
        join(found, *(100 * (k + 1) + i for i in range(sections)))
        for i in range(sections if k else 0):
            neighbours(found, 100 * k + i, 100 * (k + 1) + i)
    return found


def scene(line: ReferenceLine, sections: Sequence[Section], cars: Sequence[Car], turn: float = 0.0) -> str:
    """Return the XML text of a scene, turned about the origin."""
    cos, sin = np.cos(turn), np.sin(turn)
    rotate = np.array([[cos, sin], [-sin, cos]])
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="a" affiliation="" source="own"',
        ' benchmarkID="ZAM_Generated-1_1_T-1" date="2020-01-01">',
        "<location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude>",
        "<gpsLongitude>999</gpsLongitude></location>",
        "<scenarioTags><interstate/></scenarioTags>",
        *(lanelet_xml(one, rotate) for one in sections),
        *(_obstacle(line, one, rotate, turn) for one in cars),
        _planning_problem(line, cars[0], rotate, turn),
        "</commonRoad>",
    ]
    return "\n".join(parts)


def _points(points: np.ndarray, rotate: np.ndarray) -> str:
    return "".join(f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in (points @ rotate).tolist())


def lanelet_xml(one: Section, rotate: np.ndarray) -> str:
    bounds = ""
    for side, points in (("left", one.left), ("right", one.right)):
        marking = one.markings.get(side)
        text = f"<lineMarking>{marking}</lineMarking>" if marking else ""
        bounds += f"<{side}Bound>{_points(points, rotate)}{text}</{side}Bound>"
    links = "".join(f'<predecessor ref="{name}"/>' for name in one.predecessors)
    links += "".join(f'<successor ref="{name}"/>' for name in one.successors)
    for side, (name, same) in one.beside.items():
        links += f'<adjacent{side} ref="{name}" drivingDir="{"same" if same else "opposite"}"/>'
    return f'<lanelet id="{one.name}">{bounds}{links}<laneletType>{one.kind}</laneletType></lanelet>'


def _poses(line: ReferenceLine, one: Car, rotate: np.ndarray, turn: float) -> np.ndarray:
    x, y = line.to_plane(one.s, one.d)
    slope = np.gradient(one.d) / np.maximum(np.abs(np.gradient(one.s)), 1e-6)
    heading = line.heading(one.s) + np.arctan(slope) + turn + (np.pi if one.opposing else 0.0)
    return np.column_stack(
        [np.stack([x, y], axis=1) @ rotate, np.remainder(heading + np.pi, 2 * np.pi) - np.pi]
    )


def state_xml(tag: str, step: int, pose: Sequence[float], speed: float) -> str:
    x, y, heading = pose
    return (
        f"<{tag}><position><point><x>{x!r}</x><y>{y!r}</y></point></position>"
        f"<orientation><exact>{heading!r}</exact></orientation><time><exact>{step}</exact></time>"
        f"<velocity><exact>{float(speed)!r}</exact></velocity>"
        + (
            "<yawRate><exact>0.0</exact></yawRate><slipAngle><exact>0.0</exact></slipAngle>"
            if step == 0
            else ""
        )
        + f"</{tag}>"
    )


def _obstacle(line: ReferenceLine, one: Car, rotate: np.ndarray, turn: float) -> str:
    poses = _poses(line, one, rotate, turn).tolist()
    start = state_xml("initialState", 0, poses[0], one.speed[0])
    states = "".join(state_xml("state", t, pose, one.speed[t]) for t, pose in enumerate(poses) if t)
    return (
        f'<dynamicObstacle id="{one.name}"><type>car</type><shape><rectangle><length>{one.length}</length>'
        f"<width>{one.width}</width></rectangle></shape>{start}"
        f"<trajectory>{states}</trajectory></dynamicObstacle>"
    )


def _planning_problem(line: ReferenceLine, one: Car, rotate: np.ndarray, turn: float) -> str:
    pose = _poses(line, one, rotate, turn)[0].tolist()
    goal = (
        "<goalState><time><intervalStart>30</intervalStart><intervalEnd>60</intervalEnd></time></goalState>"
    )
    start = state_xml("initialState", 0, pose, one.speed[0])
    return f'<planningProblem id="9999">{start}{goal}</planningProblem>'


def bend(turn: float = 0.0) -> str:
    """Return three lanes around a bend; 1 follows 2 too closely, 3 changes from the right to the middle."""
    change = 1.75 + 3.5 * np.clip((np.arange(40) - 10) / 20.0, 0.0, 1.0)
    cars = [car(BEND, 1, 40.0, 5.25, 25.0), car(BEND, 2, 52.0, 5.25, 25.0), car(BEND, 3, 120.0, change, 25.0)]
    return scene(BEND, carriageway(BEND, 3), cars, turn)


def opposing(turn: float = 0.0, line: ReferenceLine = BEND) -> str:
    """Return one lane each way; 1 and 2 drive along the line, 3 comes towards them."""
    forth = [section(line, 100 + i, 100.0 * i, 100.0 * (i + 1), -3.5, 0.0) for i in range(3)]
    back = [section(line, 200 + i, 100.0 * i, 100.0 * (i + 1), 0.0, 3.5, opposing=True) for i in range(3)]
    every = [*forth, *back]
    join(every, 100, 101, 102)
    join(every, 202, 201, 200)
    for i in range(3):
        neighbours(every, 100 + i, 200 + i, same=False)
    cars = [car(line, 1, 30.0, -1.75, 20.0), car(line, 2, 70.0, -1.75, 20.0)]
    return scene(line, every, [*cars, car(line, 3, 200.0, 1.75, -10.0, opposing=True)], turn)


def merge(turn: float = 0.0) -> str:
    """Return two lanes and a ramp from the right that becomes the right lane's second predecessor."""
    main = carriageway(BEND, 2)

    def border(s):
        return -12.0 * (1.0 - (s - 20.0) / 80.0)

    ramp = section(BEND, 900, 20.0, 100.0, border, lambda s: 3.5 + border(s), kind="accessRamp")
    every = [*main, ramp]
    join(every, 900, 101)
    t = np.arange(40)
    entering = car(BEND, 2, 30.0, 0.0, 20.0)
    entering.d = np.minimum(1.75 - 12.0 * (1.0 - (entering.s - 20.0) / 80.0), 1.75)
    return scene(
        BEND,
        every,
        [car(BEND, 1, 20.0, 5.25, 22.0), entering, car(BEND, 3, 60.0, 1.75 + 0.0 * t, 22.0)],
        turn,
    )


def widening(turn: float = 0.0) -> str:
    """Return two lanes that grow from 3 to 4.2 m; 1 follows 2."""
    lanes = carriageway(BEND, 2, width=lambda s: 3.0 + 1.2 * s / 300.0)
    return scene(BEND, lanes, [car(BEND, 1, 30.0, 1.6, 15.0), car(BEND, 2, 70.0, 1.7, 15.0)], turn)


def crossing(turn: float = 0.0) -> str:
    """Return a road crossed by another, from which car 3 comes; 1 goes straight on behind 2."""
    lanes = carriageway(STRAIGHT, 1)
    across = CurvedLine((Piece(200.0),), 150.0, -100.0, np.pi / 2)
    other = section(across, 800, 0.0, 200.0, -1.75, 1.75)
    side = car(across, 3, 60.0, 0.0, 10.0)
    side.s, side.d = STRAIGHT.to_road(*across.to_plane(side.s, side.d))
    side.opposing = False
    return scene(
        STRAIGHT,
        [*lanes, other],
        [car(STRAIGHT, 1, 100.0, 1.75, 15.0), car(STRAIGHT, 2, 140.0, 1.75, 15.0), side],
        turn,
    )


KINDS = {"bend": bend, "opposing": opposing, "merge": merge, "widening": widening, "crossing": crossing}
"""Scenes by kind, each a function of the angle by which it is turned."""
