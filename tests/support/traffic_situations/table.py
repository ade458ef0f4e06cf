"""Table of situations for every rule.

Units of robustness: 10 m along, 1.75 m across, 5 m/s, 2 m/s^2, 0.1 rad, 1 s; no collision: 1 m.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from avrare.driving import Crossing, Road
from avrare.driving.reference_line import PolygonalLine
from traffic_situations.situation import LEFT, RAMP, RIGHT, ROAD, Car, Situation

# ego at 20 m/s: 400 / (2 * 10) m to stop, less 400 / (2 * 10.5) m of one ahead at 20 m/s, and 0.4 s to react
_NEEDED = 400.0 / 20.0 - 400.0 / 21.0 + 20.0 * 0.4
_CLOSE = Car(x=9.0)  # 9 m between centres, 5 m between bumpers

_R_G1 = (
    Situation(
        "R_G1", "pass", "far behind", (40.0 - _NEEDED) / 10.0, "40 m of room, 8.95 m needed",
        others={"a": Car(x=44.0)},
    ),
    Situation(
        "R_G1", "fail", "too close", (5.0 - _NEEDED) / 10.0, "5 m of room, 8.95 m needed",
        others={"a": _CLOSE},
    ),
    Situation(
        "R_G1", "boundary", "exactly as far as needed", 0.0, "room = 20 - 400/21 + 8 m",
        others={"a": Car(x=4.0 + _NEEDED)}, nudge=("a", "x", 1),
    ),
    Situation(
        "R_G1", "exempt", "a cuts in", 0.05 / 0.1, "turning in by 0.05 rad, one unit being 0.1 rad",
        others={"a": Car(x=9.0, y=3.5, heading=-0.05)},
    ),
    Situation(
        "R_G1", "fail", "a comes towards the ego", (25.0 - 28.0) / 10.0,
        "25 m of room, 28 m needed: a's braking distance does not count",
        others={"a": Car(x=29.0, heading=math.pi)},
    ),
    Situation(
        "R_G1", "fail", "a cut in 4 s ago", (5.0 - _NEEDED) / 10.0,
        "the cut-in began at sample 1 and excuses until sample 4; the sixth sample is as `too close`",
        others={"a": Car(x=9.0, y=(LEFT, 3.5, *[RIGHT] * 4), heading=(0.0, -0.05, *[0.0] * 4))}, steps=6,
    ),
)  # fmt: skip

_R_G2 = (
    Situation("R_G2", "pass", "brakes gently", 0.5, "-1 m/s² is 1 above -2, in units of 2",
              ego=Car(acceleration=-1.0)),
    Situation("R_G2", "fail", "brakes hard for nobody", -0.5, "-3 m/s² is 1 below -2, in units of 2",
              ego=Car(acceleration=-3.0)),
    Situation("R_G2", "boundary", "brakes at the threshold", 0.0, "-2 m/s²",
              ego=Car(acceleration=-2.0), nudge=("ego", "acceleration", 1)),
    Situation("R_G2", "exempt", "a is too close", (_NEEDED - 5.0) / 10.0,
              "the room is short by 3.95 m; a precedes by more, 0.5", ego=Car(acceleration=-8.0),
              others={"a": _CLOSE}),
    Situation("R_G2", "exempt", "a brakes as well", 0.25, "-3 + 1.5 m/s² is 0.5 above -2, in units of 2",
              ego=Car(acceleration=-3.0), others={"a": Car(x=44.0, acceleration=-1.5)}),
    Situation("R_G2", "fail", "a is far and does not brake", -0.5, "-3 m/s², and a gives no reason",
              ego=Car(acceleration=-3.0), others={"a": Car(x=44.0)}),
)  # fmt: skip

_R_G3 = (
    Situation("R_G3", "pass", "below the lane's limit", (33.33 - 30.0) / 5.0, "30 of 33.33 m/s",
              ego=Car(speed=30.0), options={"lane_limit": 33.33}),
    Situation("R_G3", "fail", "a truck too fast", (22.22 - 25.0) / 5.0, "25 of 22.22 m/s",
              ego=Car(speed=25.0),
              options={"vehicle_type": "truck"}),
    Situation("R_G3", "boundary", "as fast as it may brake", 0.0, "43 m/s = sqrt(2 * 10 * 92.45 m)",
              ego=Car(speed=43.0), nudge=("ego", "speed", -1)),
    Situation("R_G3", "exempt", "the limit is the ramp's", 0.75 / 1.75,
              "0.75 m off the ramp and its 13.89 m/s", ego=Car(speed=40.0),
              options={"lane_limit": (13.89, None, None)}),
    Situation("R_G3", "fail", "sees 60 m", ((0.4**2 + 12.0) ** 0.5 * 10.0 - 4.0 - 35.0) / 5.0,
              "35 m/s; from 30.87 one stops in sight: 0.4 v + v²/20 = 60 m", ego=Car(speed=35.0),
              options={"field_of_view": 60.0}),
)  # fmt: skip

_R_G4 = (
    Situation("R_G4", "pass", "with the flow", (25.0 - 21.11) / 5.0, "25 m/s; 36.11 - 15 are the least",
              ego=Car(speed=25.0)),
    Situation("R_G4", "fail", "slow for no reason", (15.0 - 21.11) / 5.0, "15 m/s of at least 21.11",
              ego=Car(speed=15.0)),
    Situation("R_G4", "boundary", "just fast enough", 0.0, "21.11 m/s", ego=Car(speed=36.11 - 15.0),
              nudge=("ego", "speed", 1)),
    Situation("R_G4", "exempt", "a slow car ahead", (21.11 - 15.0) / 5.0,
              "a is slow by 6.11 m/s, ahead by more: 26 m and 2.75 m of lane", ego=Car(speed=15.0),
              others={"a": Car(x=30.0, speed=15.0)}),
    Situation("R_G4", "fail", "a slow car in another lane", -0.75 / 1.75, "0.75 m more and a would excuse",
              ego=Car(speed=15.0), others={"a": Car(x=30.0, y=LEFT, speed=15.0)}),
)  # fmt: skip


def _queue(first: float, apart: float, count: int, **each: Any) -> dict[str, Car]:
    return {"abcdefgh"[k]: Car(x=first + apart * k, **each) for k in range(count)}


_R_I1 = (
    Situation("R_I1", "pass", "drives", (20.0 - 0.01) / 5.0, "20 m/s; below 0.01 is standing"),
    Situation("R_I1", "fail", "stands for no reason", -0.01 / 5.0, "0.01 m/s more would be driving",
              ego=Car(speed=0.0)),
    Situation("R_I1", "boundary", "all but stands", 0.0, "0.01 m/s", ego=Car(speed=0.01),
              nudge=("ego", "speed", 1)),
    Situation("R_I1", "exempt", "somebody stands ahead", 0.01 / 5.0, "a stands by 0.01 m/s",
              ego=Car(speed=0.0), others={"a": Car(x=10.0, speed=0.0)}),
    Situation("R_I1", "exempt", "in congestion", (2.78 - 2.0) / 5.0, "three ahead at 2 of 2.78 m/s",
              ego=Car(speed=0.0), others=_queue(8.0, 8.0, 3, speed=2.0)),
    Situation("R_I1", "fail", "two make no congestion", -0.01 / 5.0, "as standing for no reason",
              ego=Car(speed=0.0), others=_queue(8.0, 8.0, 2, speed=2.0)),
)  # fmt: skip

_R_I2 = (
    Situation("R_I2", "pass", "slower than the left one", 1.0 / 5.0, "slower by 1 m/s",
              others={"a": Car(y=LEFT, speed=21.0)}),
    Situation("R_I2", "fail", "faster than the left one", -4.0 / 10.0,
              "4 m of overlap along the road; 4 m/s too fast count more",
              others={"a": Car(y=LEFT, speed=16.0)}),
    Situation("R_I2", "boundary", "as fast as the left one", 0.0, "no difference",
              others={"a": Car(y=LEFT, speed=20.0)}, nudge=("a", "speed", 1)),
    Situation("R_I2", "exempt", "the left ones queue", (16.67 - 16.0) / 5.0,
              "three ahead of a at 16 of 16.67 m/s; 4 m/s faster, 5.55 allowed",
              others=_queue(0.0, 10.0, 4, y=LEFT, speed=16.0)),
    Situation("R_I2", "exempt", "from the access ramp", 2.75 / 1.75, "the ego reaches 2.75 m into the ramp",
              ego=Car(y=RAMP, speed=25.0), others={"a": Car()}),
    Situation("R_I2", "exempt", "a broad marking between them", 0.75 / 1.75,
              "each is 0.75 m off the marking at y = 3.5 m", others={"a": Car(y=LEFT, speed=16.0)},
              road=Road((RAMP, RIGHT, LEFT), 3.5, (0,), broad_markings=(1,))),
    Situation("R_I2", "fail", "too fast past a queue", (5.55 - 6.2) / 5.0, "6.2 m/s faster, 5.55 allowed",
              ego=Car(speed=22.2), others=_queue(0.0, 10.0, 4, y=LEFT, speed=16.0)),
)  # fmt: skip

_R_I3 = (
    Situation("R_I3", "pass", "drives on", (20.0 + 0.01) / 5.0, "20 m/s above -0.01"),
    Situation("R_I3", "fail", "has turned around", (1.57 - 3.0) / 0.1, "3 rad of 1.57",
              ego=Car(heading=3.0, speed=5.0)),
    Situation("R_I3", "boundary", "stands across", 0.0, "1.57 rad", ego=Car(heading=1.57, speed=5.0),
              nudge=("ego", "heading", -1)),
    Situation("R_I3", "exempt", "rolls back a little", (0.01 - 0.005) / 5.0, "0.005 of 0.01 m/s",
              ego=Car(speed=-0.005)),
    Situation("R_I3", "fail", "reverses", (0.01 - 1.0) / 5.0, "-1 m/s of -0.01", ego=Car(speed=-1.0)),
)  # fmt: skip

_WITH_SHOULDER: dict[str, Any] = {"road": Road((-1.75, RIGHT, LEFT), 3.5), "options": {"shoulder": (0,)}}
_JAM: dict[str, Any] = {"others": _queue(8.0, 12.0, 3, y=5.9, speed=2.0)}

_R_I4 = (
    Situation("R_I4", "pass", "keeps left", (0.2 - 0.1) / 1.75, "0.1 m off the left border, 0.2 allowed",
              ego=Car(y=5.9, speed=2.0), **_WITH_SHOULDER, **_JAM),
    Situation("R_I4", "fail", "stays in mid-lane", (0.2 - 0.75) / 1.75,
              "0.75 m off the left border, 0.2 allowed",
              ego=Car(y=LEFT, speed=2.0), **_WITH_SHOULDER, **_JAM),
    Situation("R_I4", "boundary", "left enough", 0.0, "0.2 m off the left border", ego=Car(y=5.8, speed=2.0),
              nudge=("ego", "y", 1), **_WITH_SHOULDER, **_JAM),
    Situation("R_I4", "exempt", "traffic flows", (20.0 - 8.33) / 5.0,
              "20 m/s ahead; only below 8.33 is it slow-moving", ego=Car(y=LEFT),
              others=_queue(24.0, 24.0, 3, y=LEFT), **_WITH_SHOULDER),
    Situation("R_I4", "fail", "on the shoulder", -0.5 / 1.75, "0.5 m onto the shoulder",
              ego=Car(y=0.5, speed=2.0), others=_queue(8.0, 12.0, 3, y=RIGHT, speed=2.0), **_WITH_SHOULDER),
    Situation("R_I4", "exempt", "a vehicle close on the right", (0.5 - 0.3) / 1.75,
              "0.3 m between them, 0.5 allowed; the border is 1.2 m off", ego=Car(y=2.2, speed=2.0),
              others={**_queue(8.0, 12.0, 3, y=2.2, speed=2.0), "d": Car(y=-0.1, speed=2.0)},
              **_WITH_SHOULDER),
    Situation("R_I4", "pass", "one lane, keeps right", (0.2 - 0.15) / 1.75,
              "3.5 m are not broad; 0.15 m off the right border, 0.2 allowed", ego=Car(y=1.15, speed=2.0),
              others=_queue(8.0, 12.0, 3, y=1.15, speed=2.0), road=Road((-1.75, RIGHT), 3.5),
              options={"shoulder": (0,)}),
)  # fmt: skip

_ENTERS: dict[str, Any] = {
    "others": {"a": Car(x=30.0, y=(RAMP, 0.0, RIGHT))}, "steps": 3, "options": {"entering_time": 2.0}
}  # fmt: skip
_TO_THE_RIGHT = (LEFT, 3.5, RIGHT)

_R_I5 = (
    Situation("R_I5", "pass", "stays left", 0.75 / 1.75, "the ego stays 0.75 m off the right lane",
              ego=Car(y=LEFT, speed=25.0), **_ENTERS),
    Situation("R_I5", "fail", "changes to the right", -0.75 / 1.75,
              "at sample 0 the ego is 0.75 m off the lane that it will be in",
              ego=Car(y=_TO_THE_RIGHT, speed=25.0), **_ENTERS),
    Situation("R_I5", "boundary", "up to the line", 0.0, "the right side reaches the line at y = 3.5 m",
              ego=Car(y=(LEFT, 4.5, 4.5), speed=25.0), nudge=("ego", "y", 1), **_ENTERS),
    Situation("R_I5", "exempt", "was in the right lane", 2.75 / 1.75, "2.75 m into the right lane all along",
              ego=Car(speed=25.0), **_ENTERS),
    Situation("R_I5", "exempt", "a stays on the ramp", 0.75 / 1.75, "a stays 0.75 m off the carriageway",
              ego=Car(y=_TO_THE_RIGHT, speed=25.0), others={"a": Car(x=30.0, y=RAMP)}, steps=3,
              options={"entering_time": 2.0}),
)  # fmt: skip

# a line across the lanes at x = 6 m; the front is 2 m before the centre
_STOP = dataclasses.replace(ROAD, stop_signs=(6.0,))
_STOPS = (3.5, 3.5, 3.5, 3.5, 6.0)  # 0.5 m before the line from 0 to 3 s, across it at 4 s

_R_IN1 = (
    Situation("R_IN1", "pass", "stands for 3 s", 0.1 / 5.0, "by 0.1 m/s; 0.5 m before the line count more",
              ego=Car(x=_STOPS, speed=0.0), steps=5, road=_STOP),
    Situation("R_IN1", "fail", "stands for 2 s", -0.5 / 10.0,
              "2 s of 3 s; 0.5 m less and it had not passed the line",
              ego=Car(x=(-1.0, *_STOPS[1:]), speed=0.0), steps=5, road=_STOP),
    Situation("R_IN1", "boundary", "all but stands", 0.0, "0.1 m/s",
              ego=Car(x=_STOPS, speed=0.1), nudge=("ego", "speed", -1), steps=5, road=_STOP),
    Situation("R_IN1", "exempt", "no stop sign", math.inf, "nothing to stand for",
              ego=Car(x=_STOPS, speed=0.0), steps=5),
    Situation("R_IN1", "fail", "drives through", -2.0 / 10.0, "no standstill; 2 m across the line",
              ego=Car(x=(2.0, 6.0), speed=4.0), steps=2, road=_STOP),
)  # fmt: skip
_LIGHT = dataclasses.replace(ROAD, light_lines=(12.0,))
_PASSES = (8.0, 11.0)  # the front is 2 m before the line, then 1 m beyond it
_YELLOWS = (-8.0, 2.0, 11.0)  # 18 m, 8 m before the line; 1 m beyond it
_R_IN2 = (
    Situation("R_IN2", "pass", "passes on green", math.inf, "neither red nor yellow",
              ego=Car(x=_PASSES, speed=3.0), steps=2, road=_LIGHT, light=(0.0, 0.0)),
    Situation("R_IN2", "fail", "passes on red", -1.0 / 10.0, "1 m across the line",
              ego=Car(x=_PASSES, speed=3.0), steps=2, road=_LIGHT, light=(2.0, 2.0)),
    Situation("R_IN2", "boundary", "its front reaches the line", 0.0, "of a red light",
              ego=Car(x=(8.0, 10.0), speed=2.0), nudge=("ego", "x", -1), steps=2, road=_LIGHT,
              light=(2.0, 2.0)),
    Situation("R_IN2", "exempt", "could not stop at yellow", 2.0 / 10.0,
              "at 12.65 m/s it needs 20 m, the line is 18 m away", ego=Car(x=_YELLOWS, speed=160.0**0.5),
              steps=3, road=_LIGHT, light=(1.0, 1.0, 1.0)),
    Situation("R_IN2", "fail", "could have stopped at yellow", -1.0 / 10.0,
              "at 10 m/s it needs 12.5 of 18 m; 1 m across the line", ego=Car(x=_YELLOWS, speed=10.0),
              steps=3, road=_LIGHT, light=(1.0, 1.0, 1.0)),
    Situation("R_IN2", "exempt", "yellow came late", 4.5 / 10.0,
              "at 10 m/s it needs 12.5 m, and 8 m are left",
              ego=Car(x=_YELLOWS, speed=10.0), steps=3, road=_LIGHT, light=(0.0, 1.0, 1.0)),
    Situation("R_IN2", "pass", "red once it stands on the line", 1.0 / 10.0,
              "it was 1 m across the line before",
              ego=Car(x=(11.0, 12.0), speed=1.0), steps=2, road=_LIGHT, light=(0.0, 2.0)),
)  # fmt: skip


def _crossing(reason: Any, degrees: float) -> Road:
    """Return a way 3.5 m wide in this direction through (20, 1.75), and its conflict area, 3.5 m long."""
    towards = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    line = PolygonalLine(np.array([[20.0, RIGHT]]) + np.outer([-40.0, 40.0], towards))
    return dataclasses.replace(ROAD, crossings=(Crossing(reason, 18.25, 21.75, line, 38.25, 41.75, 1.75),))


def _right_of_way(rule: str, reason: Any, degrees: float) -> tuple[Situation, ...]:
    def a(*before: float, acceleration: float = 0.0) -> dict[str, Car]:
        cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        x, y = (tuple(c - b * part for b in before) for c, part in ((20.0, cos), (RIGHT, sin)))
        return {"a": Car(x=x, y=y, heading=math.radians(degrees), speed=5.0, acceleration=acceleration)}

    more: Any = {"road": _crossing(reason, degrees), "options": {"after_leaving": 1.0}}
    inside, two = Car(x=20.0, speed=0.0), {"steps": 2, **more}
    at = a(8.75)["a"]
    edge = dataclasses.replace(inside, x=(16.25,), speed=5.0)  # its front where the area begins
    return (
        Situation(rule, "pass", "a is far enough", 5.0 / 10.0, "a's front is 5 m before the area",
                  ego=inside, others={"a": at}, **more),
        Situation(rule, "fail", "in a's way", -0.5 / 10.0, "the ego is 0.5 m into the area, a 3 m",
                  ego=Car(x=16.75, speed=0.0), others=a(0.75), **more),
        Situation(rule, "boundary", "at the edge of the area", 0.0, "the ego's front reaches the area",
                  ego=edge, others=a(0.75), nudge=("ego", "x", -1), **more),
        Situation(rule, "exempt", "waits before the area", 16.25 / 10.0,
                  "the ego's front is 16.25 m before the area",
                  ego=Car(speed=0.0), others=a(0.75), **more),
        Situation(rule, "fail", "a comes within 1 s", -2.0 / 10.0,
                  "a is 3 m before the area, then 2 m into it",
                  ego=inside, others=a(6.75, 1.75), **two),
        Situation(rule, "fail", "just after a", -2.0 / 10.0, "a was 2 m into the area 1 s ago",
                  ego=inside, others=a(-1.75, -6.75), **two),
        Situation(rule, "fail", "a has to brake", -0.5 / 2.0,
                  "-1.5 m/s² is 0.5 below -1, in units of 2, 5 m before the area",
                  ego=inside, others=a(8.75, acceleration=-1.5), **more),
        Situation(rule, "pass", "a brakes far away", 5.0 / 10.0, "20 m before the area, 15 count",
                  ego=inside, others=a(23.75, acceleration=-4.0), **more),
    )  # fmt: skip


_R_IN3 = _right_of_way("R_IN3", "right", 90.0)
_R_IN4 = _right_of_way("R_IN4", "sign", -90.0)
_R_IN5 = _right_of_way("R_IN5", "oncoming", -120.0)

_NO_COLLISION = (
    Situation("no_collision", "pass", "20 m apart", 20.0, "24 m between centres, 4 m of cars",
              others={"a": Car(x=24.0)}),
    Situation("no_collision", "fail", "overlap", -1.0, "3 m between centres, 4 m of cars",
              others={"a": Car(x=3.0)}),
    Situation("no_collision", "boundary", "touch", 0.0, "4 m between centres", others={"a": Car(x=4.0)},
              nudge=("a", "x", 1)),
    Situation("no_collision", "exempt", "parked cars left out", math.inf, "`vehicles: moving` leaves nobody",
              others={"a": Car(x=3.0, speed=0.0, moving=False)}, options={"vehicles": "moving"}),
    Situation("no_collision", "pass", "corner to corner", 5.0, "3 m along and 4 m across",
              others={"a": Car(x=7.0, y=7.75)}),
)  # fmt: skip

# both at 20 m/s: 20 * 1 + 3.5 / 2 + (20 + 3.5)^2 / (2 * 4) m behind one who stops in 400 / (2 * 8) m
_LONGITUDINAL = 20.0 + 1.75 + 23.5**2 / 8.0 - 400.0 / 16.0
# neither moves across: each may speed up to 0.2 m/s in 1 s, 0.1 m, and brakes by 0.8: 0.2^2 / 1.6 m
_LATERAL = 0.1 + 2.0 * (0.1 + 0.2**2 / 1.6)
# both at 20 m/s towards each other: the ways to stop of both, one of them by 3 m/s^2, the other by 4
_MEETING = 2.0 * (20.0 + 1.75) + 23.5**2 / 6.0 + 23.5**2 / 8.0
# a heads towards the ego by 0.05 rad at 20 m/s
_DRIFT = 20.0 * math.sin(0.05)
_TOWARDS = 0.1 + (0.1 + 0.2**2 / 1.6) + (_DRIFT + 0.1 + (_DRIFT + 0.2) ** 2 / 1.6)
_ASIDE = 3.5 - 1.0 - 0.5 * (4.0 * math.sin(0.05) + 2.0 * math.cos(0.05))

_RSS = (
    Situation("rss_safe_distance", "pass", "far behind", (80.0 - _LONGITUDINAL) / 10.0,
              "80 m of room, 65.78 m needed", others={"a": Car(x=84.0)}),
    Situation("rss_safe_distance", "fail", "too close", (-2.0 - _LATERAL) / 1.75,
              "25.78 m short along the road; across it the overlap of 2 m and 0.35 m are nearer",
              others={"a": Car(x=44.0)}),
    Situation("rss_safe_distance", "boundary", "exactly as far as needed", 0.0, "room = 65.78125 m",
              others={"a": Car(x=4.0 + _LONGITUDINAL)}, nudge=("a", "x", 1)),
    Situation("rss_safe_distance", "exempt", "a is in the next lane", (1.5 - _LATERAL) / 1.75,
              "1.5 m of room across, 0.35 m needed", others={"a": Car(y=LEFT)}),
    Situation("rss_safe_distance", "exempt", "a is behind", (18.0 - 2.0) / 10.0, "16 m behind",
              others={"a": Car(x=-20.0)}),
    Situation("rss_safe_distance", "fail", "a comes towards the ego", (200.0 - _MEETING) / 10.0,
              "200 m of room, 204.57 m needed by both together, a in a lane of the ego's direction",
              others={"a": Car(x=204.0, heading=math.pi)}),
    Situation("rss_safe_distance", "fail", "a drifts towards the ego", (_ASIDE - _TOWARDS) / 1.75,
              "1.40 m of room across, 2.22 m needed", others={"a": Car(x=10.0, y=LEFT, heading=-0.05)}),
)  # fmt: skip

_TTC = (
    Situation("time_to_collision", "pass", "4 s", 4.0 - 1.5, "40 m at 10 m/s, less 1.5 s",
              others={"a": Car(x=44.0, speed=10.0)}),
    Situation("time_to_collision", "fail", "1 s", 1.0 - 1.5, "10 m at 10 m/s, less 1.5 s",
              others={"a": Car(x=14.0, speed=10.0)}),
    Situation("time_to_collision", "fail", "bumper to bumper", (-2.0 - 6.0) / 10.0,
              "they touch: 1.5 s short, at equal speeds too; 8 m more and a would be behind",
              others={"a": Car(x=4.0)}),
    Situation("time_to_collision", "boundary", "1.5 s", 0.0, "15 m at 10 m/s",
              others={"a": Car(x=19.0, speed=10.0)}, nudge=("a", "x", 1)),
    Situation("time_to_collision", "exempt", "a is in the next lane", math.inf, "they never touch",
              others={"a": Car(x=14.0, y=LEFT, speed=10.0)}),
    Situation("time_to_collision", "exempt", "a closes in from behind", (12.0 - 2.0) / 10.0, "10 m behind",
              others={"a": Car(x=-14.0, speed=30.0)}),
)  # fmt: skip

SITUATIONS: tuple[Situation, ...] = (
    *(*_R_G1, *_R_G2, *_R_G3, *_R_G4),
    *(*_R_I1, *_R_I2, *_R_I3, *_R_I4, *_R_I5),
    *(*_R_IN1, *_R_IN2, *_R_IN3, *_R_IN4, *_R_IN5),
    *(*_NO_COLLISION, *_RSS, *_TTC),
)
