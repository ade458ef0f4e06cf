"""R_I1 to R_I5. Units of robustness: 10 m along, 1.75 m across, 5 m/s, 2 m/s^2, 0.1 rad."""

from __future__ import annotations

from typing import Any

from avrare.driving import Road
from avrare_traffic_rules.situations.situation import LEFT, RAMP, RIGHT, Car, Situation


def _row(first: float, apart: float, count: int, **each: Any) -> dict[str, Car]:
    """So many cars behind one another."""
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
              ego=Car(speed=0.0), others=_row(8.0, 8.0, 3, speed=2.0)),
    Situation("R_I1", "fail", "two make no congestion", -0.01 / 5.0, "as standing for no reason",
              ego=Car(speed=0.0), others=_row(8.0, 8.0, 2, speed=2.0)),
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
              others=_row(0.0, 10.0, 4, y=LEFT, speed=16.0)),
    Situation("R_I2", "exempt", "from the access ramp", 2.75 / 1.75, "the ego reaches 2.75 m into the ramp",
              ego=Car(y=RAMP, speed=25.0), others={"a": Car()}),
    Situation("R_I2", "fail", "too fast past a queue", (5.55 - 6.2) / 5.0, "6.2 m/s faster, 5.55 allowed",
              ego=Car(speed=22.2), others=_row(0.0, 10.0, 4, y=LEFT, speed=16.0)),
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
_JAM: dict[str, Any] = {"others": _row(8.0, 12.0, 3, y=5.9, speed=2.0)}

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
              others=_row(24.0, 24.0, 3, y=LEFT), **_WITH_SHOULDER),
    Situation("R_I4", "fail", "on the shoulder", -0.5 / 1.75, "0.5 m onto the shoulder",
              ego=Car(y=0.5, speed=2.0), others=_row(8.0, 12.0, 3, y=RIGHT, speed=2.0), **_WITH_SHOULDER),
    Situation("R_I4", "pass", "one lane, keeps right", (0.2 - 0.15) / 1.75,
              "3.5 m are not broad; 0.15 m off the right border, 0.2 allowed", ego=Car(y=1.15, speed=2.0),
              others=_row(8.0, 12.0, 3, y=1.15, speed=2.0), road=Road((-1.75, RIGHT), 3.5),
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

SITUATIONS = (*_R_I1, *_R_I2, *_R_I3, *_R_I4, *_R_I5)
