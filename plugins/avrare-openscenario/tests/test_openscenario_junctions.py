"""Junctions under a stack: the way of the ego as one line, others beside it, and who has priority."""

import numpy as np
import pytest

from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.simulator import OpenScenario
from openscenario_files import document, lane_position, straight

ARRIVAL = '<successor elementType="junction" elementId="7"/>'


def cross(signs="", priority=""):
    """Return road 1 to the east and 5 to the north, which go on in 2 and 6 that cross."""
    roads = (
        straight(1, 0.0, 0.0, 0.0, ARRIVAL).replace("</lanes>", f"</lanes>{signs}"),
        straight(2, 50.0, 0.0, 0.0, length=20.0, junction="7"),
        straight(5, 60.0, -60.0, 0.5 * np.pi, ARRIVAL),
        straight(6, 60.0, -10.0, 0.5 * np.pi, length=20.0, junction="7"),
    )
    ways = "".join(
        f'<connection id="{way}" incomingRoad="{road}" connectingRoad="{way}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        for road, way in ((1, 2), (5, 6))
    )
    junction = f'<junction id="7" name="">{ways}{priority}</junction>'
    return f"<OpenDRIVE><header/>{''.join(roads)}{junction}</OpenDRIVE>"


@pytest.fixture
def build(tmp_path):
    def build(road):
        (tmp_path / "motorway.xodr").write_text(road, encoding="utf-8")
        car = lane_position(20.0, -1).replace('roadId="1"', 'roadId="5"')
        text = document(car=car, ego=lane_position(30.0, -1))
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return OpenScenario(OpenScenarioConfig(file=tmp_path / "scene.xosc"))

    return build


def test_a_way_from_the_right_has_priority(build):
    simulator = build(cross())
    (area,) = simulator.scene.road.crossings
    assert area.reason == "right"
    assert (area.begin, area.end) == pytest.approx((60.0, 63.5), abs=0.3)
    assert (area.line_begin, area.line_end) == pytest.approx((6.5, 10.0), abs=0.3)
    world = simulator.reset(np.zeros((1, 0)))
    assert (world.others.heading[0, 0], world.ego.y[0]) == pytest.approx((0.5 * np.pi, 0.0), abs=1e-9)


def test_signs_decide_who_goes_first(build):
    stop = '<signals><signal id="1" type="206" s="48" t="-4"/></signals>'
    simulator = build(cross(signs=stop))
    assert [area.reason for area in simulator.scene.road.crossings] == ["sign"]
    assert simulator.scene.road.stop_signs == (50.0,)
    first = '<priority high="2" low="6"/>'
    assert build(cross(priority=first)).scene.road.crossings == ()
