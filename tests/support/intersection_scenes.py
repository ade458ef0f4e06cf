"""CommonRoad scenes on a crossroads of two roads, 3.5 m a lane; arms are numbered S, E, N, W from 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.driving.reference_line import PolygonalLine
from lanelet_scenes import Section, lanelet_xml, state_xml

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


def slows(arm: int, turn: str, start: float, until: float, rate: float = 2.0, speed: float = 8.0) -> Driver:
    """Return a car that drives at constant speed and brakes from a time on until it stands."""
    t = 0.1 * np.arange(80)
    braked = np.clip(t - until, 0.0, speed / rate)
    return Driver(arm, turn, start + speed * np.minimum(t, until + braked) - 0.5 * rate * braked**2)


SOUTH, EAST, NORTH, WEST = range(4)
EGO = drives(SOUTH, "straight", 40.0)
LEFT = drives(SOUTH, "left", 40.0)
PRIORITY = {SOUTH: "205", NORTH: "205", EAST: "306", WEST: "306"}
RED = {"lights": "50 red"}

# A straight way enters the intersection at 52 m. That of the ego from the south meets that from the east
# from 60 to 63.5 m, the other's stations being 56.5 to 60 m. A car reaches 2.25 m from its centre and drives
# 8 m/s: the ego, which starts at 40 m, is in the area from 2.22 s to 3.22 s, and its front reaches the stop
# line at 1.22 s.
RIGHT_OF_WAY: dict[str, tuple[str, list[Driver], dict[str, Any], bool | None]] = {
    # name: rule, cars, file, whether it is kept (None: with robustness infinity)
    "from the right, at once": ("R_IN3", [EGO, drives(EAST, "straight", 40.0)], {}, False),
    "from the left": ("R_IN3", [EGO, drives(WEST, "straight", 40.0)], {}, None),
    # 56.5 - 2.25 - 19 m at 8 m/s: 4.41 s, 1.19 s after the ego has left
    "from the right, 1.19 s later": ("R_IN3", [EGO, drives(EAST, "straight", 19.0)], {}, True),
    # 4.03 s, 0.81 s after
    "from the right, 0.81 s later": ("R_IN3", [EGO, drives(EAST, "straight", 22.0)], {}, False),
    # leaves the area at (60 + 2.25 - 46.9) / 8 = 1.92 s, 0.3 s before the ego enters
    "0.3 s after the other": ("R_IN3", [EGO, drives(EAST, "straight", 46.9)], {}, False),
    "0.8 s after the other": ("R_IN3", [EGO, drives(EAST, "straight", 50.9)], {}, True),
    # at 2.3 s the other's front is at 21 + 2.25 + 18.4 = 41.65 m, 14.85 m before the area, and it brakes
    "the other has to brake": ("R_IN3", [EGO, slows(EAST, "straight", 21.0, 2.3)], {}, False),
    # it begins at 3.5 s, when the ego has left
    "the other brakes later": ("R_IN3", [EGO, slows(EAST, "straight", 14.0, 3.5)], {}, True),
    "signs put right before left out of force": (
        "R_IN3", [EGO, drives(EAST, "straight", 40.0)], {"signs": PRIORITY}, None,
    ),
    "lights put right before left out of force": (
        "R_IN3", [EGO, drives(EAST, "straight", 40.0)], {"lights": "50 green"}, None,
    ),
    "yields to nobody from the left": (
        "R_IN4", [EGO, drives(WEST, "straight", 44.0)], {"signs": PRIORITY}, False,
    ),
    "has priority": ("R_IN4", [drives(EAST, "straight", 40.0), EGO], {"signs": PRIORITY}, None),
    "no signs": ("R_IN4", [EGO, drives(WEST, "straight", 44.0)], {}, None),
    "turns left before oncoming traffic": ("R_IN5", [LEFT, drives(NORTH, "straight", 40.0)], {}, False),
    "lights leave oncoming traffic its priority": (
        "R_IN5", [LEFT, drives(NORTH, "straight", 40.0)], {"lights": "50 green"}, False,
    ),
    "turns left long before oncoming traffic": (
        "R_IN5", [LEFT, drives(NORTH, "straight", 5.0)], {}, True,
    ),
    "goes straight on": ("R_IN5", [EGO, drives(NORTH, "straight", 40.0)], {}, None),
    "oncoming traffic turns right later": ("R_IN5", [LEFT, drives(NORTH, "right", 5.0)], {}, True),
    # the front is on the line at 1.22 s, so that it begins to cover it at the sample 1.3 s
    "passes on red": ("R_IN2", [EGO], RED, False),
    "passes on green": ("R_IN2", [EGO], {"lights": "50 green"}, None),
    "no lights": ("R_IN2", [EGO], {}, None),
    "red at the sample before it is on the line": ("R_IN2", [EGO], {"lights": "13 red 90 green"}, True),
    "red until it is on the line": ("R_IN2", [EGO], {"lights": "14 red 90 green"}, False),
    "red once it is on the line": ("R_IN2", [EGO], {"lights": "14 green 90 red"}, True),
    # at 8 m/s a stop at 4 m/s^2 takes 8 m; at 0.2 s the front is 8.15 m before the line, at 0.3 s 7.35 m
    "yellow while it could stop": ("R_IN2", [EGO], {"lights": "2 green 30 yellow 50 red"}, False),
    "yellow when it could stop no more": ("R_IN2", [EGO], {"lights": "3 green 30 yellow 50 red"}, True),
    "a light for another direction": ("R_IN2", [EGO], {"lights": "50 red", "direction": "left"}, None),
    "a light for its direction": ("R_IN2", [LEFT], {"lights": "50 red", "direction": "leftStraight"}, False),
}  # fmt: skip


def crossroads(
    cars: Sequence[Driver],
    signs: dict[int, str] | None = None,
    lights: str = "",
    direction: str = "all",
    turn: float = 0.0,
) -> str:
    """Return the XML text of a scene; cars are numbered from 1, signs are German numbers by arm.

    The first car's start is also a planning problem; ``lights`` is a cycle such as "20 green 5 yellow 9 red".
    """
    signs = signs or {}
    cos, sin = np.cos(turn), np.sin(turn)
    rotate = np.array([[cos, sin], [-sin, cos]])
    sections = [one for arm in range(4) for one in _arm(arm)]
    parts = [
        '<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="a" affiliation="" source="own"',
        ' benchmarkID="DEU_Generated-1_1_T-1" date="2020-01-01">',
        "<location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude>",
        "<gpsLongitude>999</gpsLongitude></location><scenarioTags><intersection/></scenarioTags>",
        *(_with_signs(one, lanelet_xml(one, rotate), signs, bool(lights)) for one in sections),
        *(_sign(arm, number) for arm, number in signs.items()),
        _light(lights, direction) if lights else "",
        _intersection(),
        *(_obstacle(number, car, rotate, turn) for number, car in enumerate(cars, start=1)),
        _problem(cars[0], rotate, turn),
        "</commonRoad>",
    ]
    return "\n".join(parts)


def way_through(arm: int, turn: str, offset: float = 0.0) -> np.ndarray:
    """Return the points (33, 2) of a way within the intersection [m]; positive offsets are to its left."""
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


def road_end(arm: int, offset: float, out: bool = False) -> np.ndarray:
    """Return the two ends (2, 2) of the lane before the intersection [m], or ``out`` of it straight on."""
    y = np.array([-FAR, -HALF]) if not out else np.array([HALF, FAR])
    return _turned(np.stack([np.full(2, LANE - offset), y], axis=1), arm)


def _exit(arm: int, turn: str) -> int:
    # the arm whose straight way leaves in the same direction
    return (arm + {"right": 3, "straight": 0, "left": 1}[turn]) % 4


def _arm(arm: int) -> list[Section]:
    inner = [300 + 10 * arm + k for k in range(3)]
    incoming = Section(100 + arm, road_end(arm, -LANE), road_end(arm, LANE), successors=inner)
    feeders = [
        300 + 10 * other + k
        for other in range(4)
        for k, turn in enumerate(TURNS)
        if _exit(other, turn) == arm
    ]
    leaving = Section(200 + arm, road_end(arm, -LANE, True), road_end(arm, LANE, True), predecessors=feeders)
    ways = [
        Section(
            name,
            way_through(arm, turn, -LANE),
            way_through(arm, turn, LANE),
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


def _light(cycle: str, direction: str) -> str:
    words = cycle.split()
    elements = "".join(
        f"<cycleElement><duration>{duration}</duration><color>{colour}</color></cycleElement>"
        for duration, colour in zip(words[::2], words[1::2], strict=True)
    )
    return (
        f'<trafficLight id="990"><cycle>{elements}<timeOffset>0</timeOffset></cycle>'
        f"<direction>{direction}</direction><active>true</active></trafficLight>"
    )


def _intersection() -> str:
    text = ""
    for arm in range(4):
        refs = "".join(
            f'<successors{turn.title()} ref="{300 + 10 * arm + k}"/>' for k, turn in enumerate(TURNS)
        )
        text += f'<incoming id="{951 + arm}"><incomingLanelet ref="{100 + arm}"/>{refs}</incoming>'
    return f'<intersection id="950">{text}</intersection>'


def route(car: Driver) -> tuple[int, int, int]:
    """Return the lanelets on which a car drives."""
    return 100 + car.arm, 300 + 10 * car.arm + TURNS.index(car.turn), 200 + _exit(car.arm, car.turn)


def _states(car: Driver, rotate: np.ndarray, turn: float) -> tuple[list[list[float]], np.ndarray]:
    parts = [
        road_end(car.arm, 0.0),
        way_through(car.arm, car.turn)[1:-1],
        road_end(_exit(car.arm, car.turn), 0.0, True),
    ]
    line = PolygonalLine(np.concatenate(parts))
    x, y, heading, _ = line.frame(car.stations)
    poses = np.column_stack([np.stack([x, y], axis=1) @ rotate, heading + turn])
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2 * np.pi) - np.pi
    speed = np.diff(car.stations, append=2 * car.stations[-1] - car.stations[-2]) / 0.1
    return poses.tolist(), speed


def _problem(car: Driver, rotate: np.ndarray, turn: float) -> str:
    poses, speed = _states(car, rotate, turn)
    goal = (
        "<goalState><time><intervalStart>30</intervalStart><intervalEnd>60</intervalEnd></time></goalState>"
    )
    start = state_xml("initialState", 0, poses[0], speed[0])
    return f'<planningProblem id="9999">{start}{goal}</planningProblem>'


def _obstacle(number: int, car: Driver, rotate: np.ndarray, turn: float) -> str:
    poses, speed = _states(car, rotate, turn)
    states = [state_xml("state" if t else "initialState", t, p, speed[t]) for t, p in enumerate(poses)]
    return (
        f'<dynamicObstacle id="{number}"><type>car</type><shape><rectangle><length>{LENGTH}</length>'
        f"<width>{WIDTH}</width></rectangle></shape>{states[0]}<trajectory>{''.join(states[1:])}"
        "</trajectory></dynamicObstacle>"
    )
