"""CommonRoad's format 2024: the same scenes as in XML, and files that are missing."""

import warnings

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_recordings.drive import monitor
from avrare_recordings.formats.commonroad import open_commonroad, open_problem, read_lanelets
from avrare_recordings.formats.drives import list_recordings, open_drives
from lanelet_scenes import KINDS


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
            writer = CommonRoadFileWriter(
                scenario, problems, "a", "b", "c", set(), file_format=FileFormat.PROTOBUF
            )
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
    assert {one.lanelet_id for one in read_lanelets(str(files["map"]))} == {
        one.lanelet_id for one in read_lanelets(str(xml))
    }


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
