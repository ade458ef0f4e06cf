"""OpenSCENARIO on the lanes of a CommonRoad file."""

import re

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving.reference_line import CurvedLine, Piece
from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.simulator import OpenScenario
from lanelet_scenes import BEND, KINDS, STRAIGHT, car, carriageway, scene, section
from openscenario_files import change_lane, document, drive, event

OFFSET = {"right": 1.75, "middle": 5.25}


@pytest.fixture
def build(tmp_path):
    def build(kind, text, turn=0.0, **options):
        (tmp_path / "map.xml").write_text(KINDS[kind](turn), encoding="utf-8")
        (tmp_path / "scene.xosc").write_text(text.replace("motorway.xodr", "map.xml"), encoding="utf-8")
        return OpenScenario(OpenScenarioConfig(file=tmp_path / "scene.xosc", **options))

    return build


def on_lanelets(*events, car="201", ego="101", s=30):
    position = '<LanePosition roadId="0" laneId="{}" s="{}" offset="0"/>'
    return document(*events, car=position.format(car, s), ego=position.format(ego, 10))


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_vehicles_keep_to_the_middle_of_a_lanelet_that_is_named(build, turn):
    simulator = build("bend", on_lanelets(), turn)
    found = drive(simulator, 8.0)
    x, y = in_plane(simulator, found)
    cos, sin = np.cos(turn), np.sin(turn)
    station, offset = BEND.to_road(cos * x + sin * y, cos * y - sin * x)
    np.testing.assert_allclose(offset, OFFSET["middle"], atol=0.02)  # the map is a polygon
    driven = np.diff(station) * (1.0 - BEND.curvature(station[1:]) * offset[1:])
    np.testing.assert_allclose(driven, 2.0, atol=0.02)


def in_plane(simulator, found):
    return simulator.scene.road.line.to_plane(found["x"][:, 0, 0], found["y"][:, 0, 0])


def test_a_lane_is_changed_to_a_lanelet(build):
    change = change_lane(value=1.0, target='<AbsoluteTargetLane value="102"/>')
    simulator = build("bend", on_lanelets(event(change)))
    x, y = in_plane(simulator, drive(simulator, 4.0))
    _, offset = BEND.to_road(x, y)
    np.testing.assert_allclose(offset[[0, -1]], [OFFSET["middle"], OFFSET["right"]], atol=0.02)


def test_traffic_of_opposing_lanelets_comes_towards_the_ego(build):
    simulator = build("opposing", on_lanelets(car="200", ego="100", s=120))
    assert simulator.scene.road.opposing == (1,)
    found = drive(simulator, 2.0)
    assert (np.diff(found["x"][:, 0, 0]) < -1.0).all()


def test_a_place_in_the_plane_is_that_of_the_map(build):
    x, y = BEND.to_plane(np.array(150.0), np.array(OFFSET["right"]))
    place = f'<WorldPosition x="{x}" y="{y}" h="{BEND.heading(np.array(150.0))}"/>'
    simulator = build(
        "bend", on_lanelets().replace('<LanePosition roadId="0" laneId="201" s="30" offset="0"/>', place)
    )
    found = drive(simulator, 0.1)
    assert (
        np.hypot(*(at[0] - there for at, there in zip(in_plane(simulator, found), (x, y), strict=True)))
        < 1e-6
    )


@pytest.mark.parametrize(
    ("kind", "message"),
    [("widening", "change their widths"), ("merge", "change their widths|begin or end")],
)
def test_a_map_that_is_not_read_is_named_where_the_scenario_names_it(build, kind, message):
    text = on_lanelets()
    line = text[: text.index("<LogicFile")].count("\n") + 1
    with pytest.raises(UsageError, match=rf"scene\.xosc:{line}:\d+: LogicFile: .*({message})"):
        build(kind, text)


def test_lanelets_that_are_not_there_are_named(build):
    with pytest.raises(UsageError, match=r"LanePosition: there is no lane 7"):
        build("bend", on_lanelets(car="7"))
    with pytest.raises(UsageError, match=r"there is no road '1'"):
        build("bend", re.sub('roadId="0"', 'roadId="1"', on_lanelets()))


def test_a_lanelet_that_crosses_the_road_is_none_of_its_lanes(build, monkeypatch):
    across = section(CurvedLine((Piece(200.0),), 150.0, -98.25, np.pi / 2), 800, 0.0, 200.0, -1.75, 1.75)
    text = scene(STRAIGHT, [*carriageway(STRAIGHT, 1), across], [car(STRAIGHT, 1, 100.0, 1.75, 15.0)])
    monkeypatch.setitem(KINDS, "across", lambda turn: text)
    with pytest.raises(UsageError, match="there is no lane 800"):
        build("across", on_lanelets(car="800", ego="101"))
