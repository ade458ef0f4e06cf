"""CommonRoad files as they are found: older and newer formats, vehicles that leave the road, odd lanes."""

import re
import warnings

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_recordings.drive_monitor import monitor
from avrare_recordings.formats.commonroad import open_commonroad, open_problem, read_lanelets
from avrare_recordings.formats.drives import list_recordings, open_drives
from avrare_recordings.roads.plane_drives import Obstacle
from lanelet_scenes import BEND, KINDS, bend, car, carriageway, scene

SET = (
    "<occupancySet><occupancy><shape><rectangle><length>4.0</length><width>2.0</width><orientation>0.0"
    "</orientation><center><x>0.0</x><y>0.0</y></center></rectangle></shape>"
    "<time><exact>1</exact></time></occupancy></occupancySet>"
)
OLD = (
    '<intersection id="900"><incoming id="901"><incomingLanelet ref="100"/><successorsRight ref="101"/>'
    '<successorsStraight ref="101"/></incoming></intersection>'
)


@pytest.fixture
def write(tmp_path):
    def write(text, name="scene.xml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return str(path)

    return write


def change_last(text, new):
    """Replace the trajectory of the last obstacle."""
    begin, end = text.rindex("<trajectory>"), text.rindex("</trajectory>") + len("</trajectory>")
    return text[:begin] + new + text[end:]


@pytest.mark.parametrize("future", [SET, ""])
def test_an_obstacle_without_a_trajectory_stands_where_it_starts(write, caplog, future):
    path = write(change_last(bend(0.3), future))
    drives = open_commonroad(path)
    assert drives.names == ("1", "2")
    whole = open_commonroad(write(bend(0.3), "whole.xml")).recording("1")
    signals = drives.recording("1").signals
    at = whole.names.index("3")
    np.testing.assert_allclose(signals["others_x"][:, at], whole.signals["others_x"][0, at])
    assert not signals["others_speed"][:, at].any()
    assert caplog.messages == [f"{path}: obstacle 3 has no trajectory of points: it stands where it starts"]


def test_a_vehicle_is_absent_while_it_is_off_the_road(write):
    aside = np.where(np.arange(40) < 10, 5.25, 60.0)
    cars = [car(BEND, 1, 20.0, 1.75, 20.0), car(BEND, 2, 60.0, aside, 20.0)]
    signals = open_commonroad(write(scene(BEND, carriageway(BEND, 2), cars))).recording("1").signals
    assert (signals["others_x"][:10] > 50.0).all()
    assert (signals["others_x"][11:] == -1e6).all()


def test_an_ego_that_leaves_the_road_is_named(write):
    aside = np.where(np.arange(40) < 30, 1.75, 60.0)
    path = write(scene(BEND, carriageway(BEND, 2), [car(BEND, 1, 20.0, aside, 20.0)]))
    with pytest.raises(UsageError, match="obstacle 1 leaves the road at step 30"):
        open_commonroad(path).recording("1")


def test_a_file_of_the_older_protobuf_is_named(tmp_path):
    path = tmp_path / "old.pb"
    path.write_bytes(b"\x0a\xc8\x01\x0a\x052020a\x12\x12FRA_Anglet-1_1_T-1")
    with pytest.raises(UsageError, match="protobuf of format 2020a") as caught:
        open_commonroad(str(path))
    assert "write it as XML" in caught.value.hint


def test_remarks_on_old_elements_are_one_line(write, caplog, capfd):
    path = write(bend(0.3).replace("<planningProblem", OLD + "<planningProblem", 1))
    open_commonroad(path)
    [line] = caplog.messages
    assert re.fullmatch(
        r".*scene\.xml: successorRight 101 is of deprecated .*, and 1 more of this kind", line
    )
    assert "deprecated" not in capfd.readouterr().err.replace(line, "")


def test_a_lane_that_turns_back_on_itself_has_numbers(write):
    # The second point of both borders lies behind the first by half a metre.
    lanes = carriageway(BEND, 1)
    for border in (lanes[1].left, lanes[1].right):
        step = border[1] - border[0]
        border[1] = border[0] - 0.5 * step / np.hypot(*step)
    cars = [car(BEND, 1, 70.0, 1.75, 20.0), car(BEND, 2, 85.0, 1.75, 20.0)]
    path = write(scene(BEND, lanes, cars))
    result = monitor(path, rule="R_G1", ego="1")
    assert np.isfinite(result.robustness)


def test_a_vehicle_without_a_foot_is_absent():
    states = np.array([[0.0, np.nan], [0.0] * 2, [0.0] * 2, [1.0] * 2])
    obstacle = Obstacle("1", 4.0, 2.0, np.array([0, 1]), states)
    assert obstacle.track(0, 2, 0.0, BEND).present.tolist() == [True, False]


@pytest.fixture
def convert(tmp_path):
    def convert(kind):
        from commonroad.common.file_reader import CommonRoadFileReader
        from commonroad.common.file_writer import CommonRoadFileWriter
        from commonroad.common.util import FileFormat

        xml = tmp_path / "scene.xml"
        xml.write_text(KINDS[kind](0.3), encoding="utf-8")
        scenario, problems = CommonRoadFileReader(str(xml)).open()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            texts, binary = ("a", "b", "c", set()), {"file_format": FileFormat.PROTOBUF}
            writer = CommonRoadFileWriter(scenario, problems, *texts, **binary)
            names = {"map": "ZAM_Generated-1", "dynamic": "ZAM_Generated-1_1_T-1"}
            names["scenario"] = f"{names['dynamic']}-SC"
            for part, name in names.items():
                getattr(writer, f"write_{part}_to_file")(str(tmp_path / f"{name}.pb"))
        return xml, {part: tmp_path / f"{name}.pb" for part, name in names.items()}

    return convert


@pytest.mark.parametrize("kind", ["bend", "opposing", "merge"])
def test_a_scene_is_that_of_its_xml(convert, kind):
    xml, files = convert(kind)
    expected = open_commonroad(str(xml)).recording("1")
    for path in (files["dynamic"], files["scenario"]):
        found = open_drives(str(path)).recording("1")
        assert found.names == expected.names
        for name, values in expected.signals.items():
            np.testing.assert_allclose(found.signals[name], values, atol=1e-6)
        road, other = expected.scene.road, found.scene.road
        assert other.lane_centres == pytest.approx(road.lane_centres)
        assert (other.access_ramp, other.opposing) == (road.access_ramp, road.opposing)


def test_the_command_reads_one_drive(convert):
    _, files = convert("bend")
    result = monitor(files["dynamic"], rule="R_G1", ego="1")
    assert result.violated


def test_problems_and_lanelets(convert):
    xml, files = convert("bend")
    (_, start), (_, expected) = open_problem(str(files["scenario"])), open_problem(str(xml))
    np.testing.assert_allclose(start.states, expected.states)
    ids, others = ({one.lanelet_id for one in read_lanelets(str(path))} for path in (files["map"], xml))
    assert ids == others


def test_a_folder_has_each_scene_once(convert, tmp_path):
    _, files = convert("bend")
    assert list_recordings(tmp_path) == [files["dynamic"], tmp_path / "scene.xml"]


def test_what_is_missing_is_named(convert, tmp_path):
    _, files = convert("bend")
    files["map"].unlink()
    with pytest.raises(UsageError, match=r"its map ZAM_Generated-1\.pb is not beside it"):
        open_commonroad(str(files["dynamic"]))
    files["scenario"].unlink()
    with pytest.raises(UsageError, match="no such file"):
        open_commonroad(str(files["map"]))
    for data in (b"", b"\xff\xff\xff"):
        (tmp_path / "odd.pb").write_bytes(data)
        with pytest.raises(UsageError, match="not a CommonRoad scenario"):
            open_commonroad(str(tmp_path / "odd.pb"))
