"""R_G1 to R_G4. Units of robustness: 10 m along, 1.75 m across, 5 m/s, 2 m/s^2, 0.1 rad."""

from __future__ import annotations

import math

from avrare_traffic_rules.situations.situation import LEFT, RIGHT, Car, Situation

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

SITUATIONS = (*_R_G1, *_R_G2, *_R_G3, *_R_G4)
