"""Rules of intersections on CommonRoad files, verdicts by hand (``intersection_scenes``), and priority."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving.values import GREEN, YELLOW
from avrare.driving.values import RED as RED_LIGHT
from avrare_recordings.formats.commonroad import open_commonroad
from avrare_recordings.roads.crossings import show_lights
from avrare_recordings.roads.ways import Way, prefer
from intersection_scenes import (
    EAST,
    EGO,
    ENTRY,
    LENGTH,
    PRIORITY,
    RED,
    RIGHT_OF_WAY,
    SOUTH,
    crossroads,
    drives,
    stops,
)
from judged_recordings import judge

FRONT = ENTRY - 0.5 * LENGTH  # a centre whose front is at the end of the incoming lanelet


@pytest.fixture
def recording(tmp_path):
    def read(cars, **more):
        path = tmp_path / "scene.xml"
        path.write_text(crossroads(cars, **more), encoding="utf-8")
        return open_commonroad(str(path)).recording("1")

    return read


@pytest.mark.parametrize("title", RIGHT_OF_WAY)
def test_right_of_way(recording, title):
    rule, cars, more, kept = RIGHT_OF_WAY[title]
    violated, robustness = judge(rule, recording(cars, turn=0.7, **more))
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
    assert (area.begin, area.end) == (pytest.approx(begins, abs=0.2), pytest.approx(begins + 3.5, abs=0.3))
    assert area.half_width == pytest.approx(1.75)


def test_the_stop_line_is_the_end_of_the_lanelet(recording):
    found = recording([stops(SOUTH, "straight", FRONT, 1.0)], signs={SOUTH: "206"})
    (line,) = found.scene.road.stop_signs
    assert line == pytest.approx(float(found.signals["ego_x"][20]) + 0.5 * LENGTH, abs=1e-6)


def damaged(tmp_path, pattern, by):
    """Return the road of an ego in a scene with signs and lights of which something is replaced."""
    text = crossroads([EGO, drives(EAST, "straight", 40.0)], signs=PRIORITY, **RED)
    changed = re.sub(pattern, by, text, flags=re.DOTALL)
    assert changed != text
    path = tmp_path / "scene.xml"
    path.write_text(changed, encoding="utf-8")
    return open_commonroad(str(path)).recording("1").scene.road


@pytest.mark.parametrize(
    ("pattern", "by", "message"),
    [
        ("<trafficSign id.*?</trafficSign>", "", "lanelet 100 refers to the traffic sign 900, which is not"),
        ("<trafficLight id.*?</trafficLight>", "", "lanelet 100 refers to the traffic light 990, which is"),
        ('incomingLanelet ref="101"', 'incomingLanelet ref="777"', "950 has the incoming lanelet 777, which"),
        ("<duration>50", "<duration>0", "the cycle of traffic light 990 takes no time"),
        (
            "<cycle>.*?</cycle>",
            "",
            r"scene\.xml: not a CommonRoad scenario: an element or attribute .* is",
        ),
    ],
)
def test_files_that_refer_to_nothing_are_refused(tmp_path, pattern, by, message):
    with pytest.raises(UsageError, match=message):
        damaged(tmp_path, pattern, by)


def test_a_light_that_is_off_leaves_the_signs_in_force(tmp_path):
    road = damaged(tmp_path, "<active>true", "<active>false")
    assert road.light_lines == ()
    assert {one.reason for one in road.crossings} == {"sign"}


@pytest.mark.parametrize(("turn", "lines"), [("right", 0), ("straight", 1), ("left", 1)])
def test_a_green_arrow_frees_the_way_to_the_right_alone(recording, turn, lines):
    road = recording([drives(SOUTH, turn, 40.0)], signs={SOUTH: "720"}, **RED).scene.road
    assert len(road.light_lines) == lines
    assert len(recording([drives(SOUTH, turn, 40.0)], **RED).scene.road.light_lines) == 1


@pytest.mark.parametrize(("direction", "lines"), [("left", 0), ("straight", 1)])
def test_a_light_without_an_intersection_is_one_for_the_way_ahead(tmp_path, direction, lines):
    text = crossroads([EGO], lights="50 red", direction=direction)
    path = tmp_path / "scene.xml"
    path.write_text(re.sub("<intersection id.*</intersection>", "", text, flags=re.DOTALL), encoding="utf-8")
    assert len(open_commonroad(str(path)).recording("1").scene.road.light_lines) == lines


def test_of_several_lights_the_strictest_counts():
    states = {1: ["green", "redYellow", "yellow", "inactive"], 2: ["green", "green", "red", "yellow"]}

    def light(name):
        every, show = SimpleNamespace(value="all"), lambda step: SimpleNamespace(value=states[name][step])
        return SimpleNamespace(active=True, direction=every, get_state_at_time_step=show)

    lanelet = SimpleNamespace(lanelet_id=7, traffic_lights={1, 2}, traffic_signs=())
    network = SimpleNamespace(lanelets=[lanelet], intersections=[], find_traffic_light_by_id=light)
    assert show_lights(network, [7], range(4))["light_0"].tolist() == [GREEN, RED_LIGHT, RED_LIGHT, YELLOW]
    assert show_lights(network, [], range(4)) == {}


def test_lights_are_read_from_the_first_sample_on(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(crossroads([EGO], lights="13 red 90 green"), encoding="utf-8")
    drives_of = open_commonroad(str(path))
    own = drives_of.obstacles["1"]
    road, lights = drives_of.add_rules(drives_of.find_road(own)[0], own, [], 10, 6)
    assert len(road.light_lines) == 1
    assert lights["light_0"].tolist() == [RED_LIGHT] * 3 + [GREEN] * 3


TO_NORTH, TO_WEST, TO_SOUTH, TO_EAST = (
    0.5 * math.pi * k for k in range(1, 5)
)  # who drives north comes from the south


def way(heading, turn="straight", rank=1, lights=False):
    points = np.array([[0.0, 0.0], [0.0, 1.0]])
    return Way(1, points, points, rank, heading, turn, lights)


@pytest.mark.parametrize(
    ("mine", "other", "reason"),
    [
        (way(TO_NORTH), way(TO_WEST), "right"),
        (way(TO_NORTH), way(TO_EAST), None),
        (way(TO_NORTH), way(TO_NORTH + 0.2 * math.pi), None),  # it merges
        (way(TO_NORTH, rank=0), way(TO_EAST, rank=2), "sign"),
        (way(TO_NORTH, rank=2), way(TO_WEST, rank=0), None),
        (way(TO_NORTH, "left"), way(TO_SOUTH), "oncoming"),
        (way(TO_NORTH, "left"), way(TO_SOUTH, "right"), "oncoming"),
        (way(TO_NORTH, "left"), way(TO_SOUTH, "left"), None),
        (way(TO_NORTH, "right"), way(TO_SOUTH), None),
        (way(TO_NORTH, "left", rank=2), way(TO_SOUTH, rank=0), None),
        # Lights leave oncoming traffic alone its priority, whatever the signs.
        (way(TO_NORTH, lights=True), way(TO_WEST), None),
        (way(TO_NORTH, rank=0, lights=True), way(TO_EAST, rank=2), None),
        (way(TO_NORTH, "left", rank=2, lights=True), way(TO_SOUTH, rank=0), "oncoming"),
        (way(TO_NORTH, "left", rank=0, lights=True), way(TO_SOUTH, rank=2), "oncoming"),
    ],
)
def test_priority(mine, other, reason):
    assert prefer(mine, other) == reason
