"""RSS and time to collision, in units of 10 m along, 1.75 m across and 1 s; no collision, in metres."""

from __future__ import annotations

import math

from avrare_traffic_rules.situations.situation import LEFT, Car, Situation

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
    Situation("rss_safe_distance", "fail", "a comes towards the ego", (80.0 - _LONGITUDINAL - 25.0) / 10.0,
              "80 m of room, 90.78 m needed: a's braking distance does not count",
              others={"a": Car(x=84.0, heading=math.pi)}),
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

SITUATIONS = (*_NO_COLLISION, *_RSS, *_TTC)
