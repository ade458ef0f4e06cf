"""Rules of intersections on CommonRoad files; every verdict is worked out by hand.

A straight way enters the intersection at 52 m. That of the ego from the south meets that from the east from
60 to 63.5 m, the other's stations being 56.5 to 60 m. A car reaches 2.25 m from its centre and drives 8 m/s:
the ego, which starts at 40 m, is in the area from 2.22 s to 3.22 s.
"""

import math

import numpy as np
import pytest

from avrare.results.recordings.commonroad import open_commonroad
from avrare.stack.builder import build_rule
from intersection_scenes import ENTRY, LENGTH, crossroads, drives, stops

pytest.importorskip("commonroad.common.file_reader")

SOUTH, EAST, NORTH, WEST = range(4)
EGO = drives(SOUTH, "straight", 40.0)
LEFT = drives(SOUTH, "left", 40.0)
PRIORITY = {SOUTH: "205", NORTH: "205", EAST: "306", WEST: "306"}
FRONT = ENTRY - 0.5 * LENGTH  # a centre whose front is at the end of the incoming lanelet

RIGHT_OF_WAY = {
    # name: rule, cars, file, robustness (None: infinite)
    "from the right, at once": ("R_IN3", [EGO, drives(EAST, "straight", 40.0)], {}, False),
    "from the left": ("R_IN3", [EGO, drives(WEST, "straight", 40.0)], {}, None),
    # 56.5 - 2.25 - 19 m at 8 m/s: 4.41 s, 1.19 s after the ego has left
    "from the right, 1.19 s later": ("R_IN3", [EGO, drives(EAST, "straight", 19.0)], {}, True),
    # 4.03 s, 0.81 s after
    "from the right, 0.81 s later": ("R_IN3", [EGO, drives(EAST, "straight", 22.0)], {}, False),
    # leaves the area at (60 + 2.25 - 46.9) / 8 = 1.92 s, 0.3 s before the ego enters
    "0.3 s after the other": ("R_IN3", [EGO, drives(EAST, "straight", 46.9)], {}, False),
    "0.8 s after the other": ("R_IN3", [EGO, drives(EAST, "straight", 50.9)], {}, True),
    "signs put right before left out of force": (
        "R_IN3", [EGO, drives(EAST, "straight", 40.0)], {"signs": PRIORITY}, None,
    ),
    "lights put right before left out of force": (
        "R_IN3", [EGO, drives(EAST, "straight", 40.0)], {"lights": True}, None,
    ),
    "yields to nobody from the left": (
        "R_IN4", [EGO, drives(WEST, "straight", 44.0)], {"signs": PRIORITY}, False,
    ),
    "has priority": ("R_IN4", [drives(EAST, "straight", 40.0), EGO], {"signs": PRIORITY}, None),
    "no signs": ("R_IN4", [EGO, drives(WEST, "straight", 44.0)], {}, None),
    "turns left before oncoming traffic": ("R_IN5", [LEFT, drives(NORTH, "straight", 40.0)], {}, False),
    "lights leave oncoming traffic its priority": (
        "R_IN5", [LEFT, drives(NORTH, "straight", 40.0)], {"lights": True}, False,
    ),
    "turns left long before oncoming traffic": (
        "R_IN5", [LEFT, drives(NORTH, "straight", 5.0)], {}, True,
    ),
    "goes straight on": ("R_IN5", [EGO, drives(NORTH, "straight", 40.0)], {}, None),
    "oncoming traffic turns right later": ("R_IN5", [LEFT, drives(NORTH, "right", 5.0)], {}, True),
}  # fmt: skip


@pytest.fixture
def recording(tmp_path):
    def read(cars, **more):
        path = tmp_path / "scene.xml"
        path.write_text(crossroads(cars, **more), encoding="utf-8")
        return open_commonroad(str(path)).recording("1")

    return read


def judge(name, recording):
    rule = build_rule(name, [], recording.scene)
    state = rule.start(1)
    for t in range(recording.samples):
        state, verdict = rule.update(state, {key: x[t : t + 1] for key, x in recording.signals.items()})
    return bool(verdict.violated[0]), float(verdict.robustness[0])


@pytest.mark.parametrize("title", RIGHT_OF_WAY)
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_right_of_way(recording, title, turn):
    rule, cars, more, kept = RIGHT_OF_WAY[title]
    violated, robustness = judge(rule, recording(cars, turn=turn, **more))
    assert violated == (kept is False)
    assert (robustness == math.inf) == (kept is None)


@pytest.mark.parametrize(
    ("at", "seconds", "violated"),
    [(FRONT - 0.5, 3.5, False), (FRONT - 0.5, 2.0, True), (FRONT - 2.0, 3.5, True), (FRONT - 0.5, 0.0, True)],
)
def test_stop_sign(recording, at, seconds, violated):
    found = recording([stops(SOUTH, "straight", at, seconds)], signs={SOUTH: "206"})
    assert judge("R_IN1", found)[0] == violated
    assert judge("R_IN1", recording([stops(SOUTH, "straight", at, seconds)]))[1] == math.inf


def test_the_conflict_area(recording):
    road = recording([EGO]).scene.road
    straight = [one for one in road.crossings if one.line.length == pytest.approx(16.0)]
    (area,) = (one for one in straight if one.reason == "right")
    assert (area.line_begin, area.line_end) == (pytest.approx(4.5, abs=0.2), pytest.approx(8.0, abs=0.2))
    begins = float(road.line.to_road(np.array([1.75]), np.array([0.0]))[0][0])
    assert (area.begin, area.end) == (
        pytest.approx(begins, abs=0.2),
        pytest.approx(begins + 3.5, abs=0.3),
    )
    assert area.half_width == pytest.approx(1.75)


def test_the_stop_line_is_the_end_of_the_lanelet(recording):
    found = recording([stops(SOUTH, "straight", FRONT, 1.0)], signs={SOUTH: "206"})
    (line,) = found.scene.road.stop_signs
    assert line == pytest.approx(float(found.signals["ego_x"][20]) + 0.5 * LENGTH, abs=1e-6)
