"""CommonRoad scenes on a crossroads of two roads, 3.5 m a lane; arms are numbered S, E, N, W from 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.driving.reference_line import PolygonalLine
from lanelet_scenes import Section, _lanelet, _state

TURNS = ("right", "straight", "left")
HALF, FAR = 8.0, 60.0  # the intersection's, and that of what is drawn [m]
LANE, LENGTH, WIDTH = 1.75, 4.5, 1.8
ENTRY = FAR - HALF
"""Station at which a way enters the intersection [m]."""


@dataclass(frozen=True)
class Driver:
    """A car from an arm that turns, by its station at every step."""

    arm: int
    turn: str
    stations: np.ndarray


def drives(arm: int, turn: str, start: float, speed: float = 8.0, steps: int = 80) -> Driver:
    """Return a car at constant speed."""
    return Driver(arm, turn, start + 0.1 * speed * np.arange(steps))


def stops(arm: int, turn: str, at: float, seconds: float, speed: float = 5.0) -> Driver:
    """Return a car that comes, stands with its centre at a station, and goes on."""
    step = 0.1 * speed
    before = at - step * np.arange(20, 0, -1)
    after = at + step * np.arange(1, 40)
    return Driver(arm, turn, np.concatenate([before, np.full(round(10 * seconds) + 1, at), after]))


def crossroads(
    cars: Sequence[Driver], signs: dict[int, str] | None = None, lights: bool = False, turn: float = 0.0
) -> str:
    """Return the XML text of a scene; cars are numbered from 1, signs are German numbers by arm."""
    signs = signs or {}
    cos, sin = np.cos(turn), np.sin(turn)
    rotate = np.array([[cos, sin], [-sin, cos]])
    sections = [one for arm in range(4) for one in _arm(arm)]
    parts = [
        '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="a" affiliation="" source="own"',
        ' benchmarkID="DEU_Generated-1_1_T-1" date="2020-01-01">',
        "<location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude>",
        "<gpsLongitude>999</gpsLongitude></location><scenarioTags><intersection/></scenarioTags>",
        *(_with_signs(one, _lanelet(one, rotate), signs, lights) for one in sections),
        *(_sign(arm, number) for arm, number in signs.items()),
        _light() if lights else "",
        _intersection(),
        *(_obstacle(number, car, rotate, turn) for number, car in enumerate(cars, start=1)),
        "</commonRoad>",
    ]
    return "\n".join(parts)


def _way(arm: int, turn: str, offset: float = 0.0) -> np.ndarray:
    # the stretch within the intersection; positive offsets are to the left
    x = LANE - offset
    if turn == "straight":
        points = np.stack([np.full(33, x), np.linspace(-HALF, HALF, 33)], axis=1)
    else:
        side, angle = (1.0 if turn == "right" else -1.0), np.linspace(0.0, 0.5 * np.pi, 33)
        radius = HALF - side * x
        points = np.stack([side * (HALF - radius * np.cos(angle)), -HALF + radius * np.sin(angle)], axis=1)
    return _turned(points, arm)


def _turned(points: np.ndarray, arm: int) -> np.ndarray:
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[arm]
    return points @ np.array([[cos, sin], [-sin, cos]], dtype=float)


def _ends(arm: int, offset: float, out: bool = False) -> np.ndarray:
    y = np.array([-FAR, -HALF]) if not out else np.array([HALF, FAR])
    return _turned(np.stack([np.full(2, LANE - offset), y], axis=1), arm)


def _exit(arm: int, turn: str) -> int:
    # the arm whose straight way leaves in the same direction
    return (arm + {"right": 3, "straight": 0, "left": 1}[turn]) % 4


def _arm(arm: int) -> list[Section]:
    inner = [300 + 10 * arm + k for k in range(3)]
    incoming = Section(100 + arm, _ends(arm, -LANE), _ends(arm, LANE), successors=inner)
    feeders = [
        300 + 10 * other + k
        for other in range(4)
        for k, turn in enumerate(TURNS)
        if _exit(other, turn) == arm
    ]
    leaving = Section(200 + arm, _ends(arm, -LANE, True), _ends(arm, LANE, True), predecessors=feeders)
    ways = [
        Section(
            name,
            _way(arm, turn, -LANE),
            _way(arm, turn, LANE),
            successors=[200 + _exit(arm, turn)],
            predecessors=[100 + arm],
        )
        for name, turn in zip(inner, TURNS, strict=True)
    ]
    return [incoming, leaving, *ways]


def _with_signs(one: Section, text: str, signs: dict[int, str], lights: bool) -> str:
    arm = one.name - 100
    if not 0 <= arm < 4:
        return text
    more = f'<trafficSignRef ref="{900 + arm}"/>' if arm in signs else ""
    more += '<trafficLightRef ref="990"/>' if lights else ""
    return text.replace("</lanelet>", more + "</lanelet>")


def _sign(arm: int, number: str) -> str:
    return (
        f'<trafficSign id="{900 + arm}"><trafficSignElement><trafficSignID>{number}</trafficSignID>'
        "</trafficSignElement><virtual>false</virtual></trafficSign>"
    )


def _light() -> str:
    return (
        '<trafficLight id="990"><cycle><cycleElement><duration>50</duration><color>green</color>'
        "</cycleElement><timeOffset>0</timeOffset></cycle><active>true</active></trafficLight>"
    )


def _intersection() -> str:
    text = ""
    for arm in range(4):
        refs = "".join(
            f'<successors{turn.title()} ref="{300 + 10 * arm + k}"/>' for k, turn in enumerate(TURNS)
        )
        text += f'<incoming id="{951 + arm}"><incomingLanelet ref="{100 + arm}"/>{refs}</incoming>'
    return f'<intersection id="950">{text}</intersection>'


def _obstacle(number: int, car: Driver, rotate: np.ndarray, turn: float) -> str:
    parts = [
        _ends(car.arm, 0.0),
        _way(car.arm, car.turn)[1:-1],
        _ends(_exit(car.arm, car.turn), 0.0, True),
    ]
    line = PolygonalLine(np.concatenate(parts))
    x, y, heading, _ = line.frame(car.stations)
    poses = np.column_stack([np.stack([x, y], axis=1) @ rotate, heading + turn])
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2 * np.pi) - np.pi
    speed = np.diff(car.stations, append=2 * car.stations[-1] - car.stations[-2]) / 0.1
    states = [_state("state" if t else "initialState", t, p, speed[t]) for t, p in enumerate(poses.tolist())]
    return (
        f'<dynamicObstacle id="{number}"><type>car</type><shape><rectangle><length>{LENGTH}</length>'
        f"<width>{WIDTH}</width></rectangle></shape>{states[0]}<trajectory>{''.join(states[1:])}"
        "</trajectory></dynamicObstacle>"
    )
