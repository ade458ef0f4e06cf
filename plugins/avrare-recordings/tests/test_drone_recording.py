"""Recordings in the formats of highD and inD, written by hand."""

import math

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare_recordings.formats.commonroad import open_commonroad
from avrare_recordings.formats.drives import list_recordings, open_drives
from drone_files import MARKINGS, highd_rows, write_highd, write_ind
from intersection_scenes import EAST, EGO, PRIORITY, RED, RIGHT_OF_WAY, SOUTH, crossroads, drives, stops
from judged_recordings import judge


class TestHighd:
    @pytest.fixture
    def drives(self, tmp_path):
        rows = [
            *highd_rows(1, 50.0, 26.0, 30.0, range(10, 40)),  # lower, right lane
            *highd_rows(2, 70.0, 22.0, 20.0, range(60)),  # lower, left lane
            *highd_rows(3, 300.0, 10.0, 25.0, range(30), -1.0),  # upper, right lane
            *highd_rows(4, 280.0, 14.0, 25.0, range(30), -1.0),  # upper, left lane
        ]
        return open_drives(write_highd(tmp_path, rows, {1: 2, 2: 2, 3: 1, 4: 1}))

    def test_the_lower_carriageway(self, drives):
        found = drives.recording("1")
        assert (found.samples, found.dt, found.names) == (30, 0.04, ("2",))
        assert found.scene.road.lane_centres == (-26.0, -22.0)
        np.testing.assert_allclose(found.signals["ego_x"][[0, -1]], [50.0, 50.0 + 30.0 * 0.04 * 29])
        np.testing.assert_allclose(found.signals["ego_y"], -26.0)
        np.testing.assert_allclose(found.signals["others_y"], -22.0)
        np.testing.assert_allclose(found.signals["others_x"][0], 70.0 + 20.0 * 0.04 * 10)

    def test_the_upper_one_is_seen_by_its_drivers(self, drives):
        found = drives.recording("3")
        assert found.names == ("4",)
        assert found.scene.road.lane_centres == (10.0, 14.0)  # the right lane first
        assert np.all(np.diff(found.signals["ego_x"]) > 0.0)
        np.testing.assert_allclose(found.signals["ego_heading"], 0.0, atol=1e-12)
        np.testing.assert_allclose(found.signals["ego_speed"], 25.0)
        assert found.signals["others_y"][0, 0] > found.signals["ego_y"][0]  # to its left
        assert found.signals["others_x"][0, 0] > found.signals["ego_x"][0]  # and ahead

    def test_mistakes(self, drives, tmp_path):
        with pytest.raises(UsageError, match="unknown vehicle '9'"):
            drives.recording("9")
        rows = highd_rows(1, 50.0, 26.0, 30.0, [0, 1, 3])
        with pytest.raises(UsageError, match="gaps in time"):
            open_drives(write_highd(tmp_path, rows, {1: 2})).recording("1")
        with pytest.raises(UsageError, match="no drivingDirection"):
            open_drives(write_highd(tmp_path, rows, {7: 2}))
        path = write_highd(tmp_path, ["1,2,x"], {1: 2})
        with pytest.raises(UsageError, match="not a recording in the format"):
            open_drives(path)

    @pytest.mark.parametrize(
        ("file", "old", "new", "words"),
        [
            ("recordingMeta", "1,25,", "1,0,", "recordingMeta.csv: the frameRate is 0"),
            ("recordingMeta", "1,25,", "1,nan,", "recordingMeta.csv: the frameRate is nan"),
            ("recordingMeta", "1,25,", "1,inf,", "recordingMeta.csv: the frameRate is inf"),
            ("recordingMeta", "1,25,", "1,x,", "not a recording in the format"),
            ("recordingMeta", f"1,25,{MARKINGS[0]},{MARKINGS[1]}", "1", "not a recording in the format"),
            ("recordingMeta", f",{MARKINGS[1]}", "", "no lane markings"),
            ("recordingMeta", MARKINGS[1], "nan;20;24", "the lane markings 'nan;20;24' are not numbers"),
            ("recordingMeta", "1,25", "\udcff", "recordingMeta.csv: not CSV in UTF-8"),
            ("tracksMeta", "1,4.5,1.8,2", "1,4.5", "lacks id or drivingDirection"),
            ("tracksMeta", "1,4.5", '"' + "1" * 200_000, "tracksMeta.csv: not CSV in UTF-8"),
            ("tracks", "0,1,47.75,", "0,1,nan,", "tracks.csv: row 1 has no number for x"),
            ("tracks", "0,1,47.75,", "0,nan,47.75,", "tracks.csv: row 1 has no number for id"),
            ("tracks", "laneId", "\udcff", "tracks.csv: not CSV in UTF-8"),
        ],
    )
    def test_damaged_files_are_named(self, tmp_path, file, old, new, words):
        path = write_highd(tmp_path, highd_rows(1, 50.0, 26.0, 30.0, range(3)), {1: 2})
        damaged = tmp_path / f"01_{file}.csv"
        text = damaged.read_text()
        assert old in text
        damaged.write_bytes(text.replace(old, new, 1).encode("utf-8", "surrogateescape"))
        with pytest.raises(UsageError, match=words):
            open_drives(path)


class TestInd:
    def test_centres_and_degrees_on_the_callers_road(self, tmp_path):
        rows = [f"0,{v},{f},{10 * v + 0.4 * f},1.75,0,1.8,4.5,10,0,0,0" for v in (1, 2) for f in range(20)]
        found = open_drives(write_ind(tmp_path, rows), Road((1.75,), 3.5)).recording("1")
        assert (found.samples, found.names, found.scene.ego_length) == (20, ("2",), 4.5)
        np.testing.assert_allclose(found.signals["ego_speed"], 10.0)
        assert len(list_recordings(tmp_path)) == 1
        with pytest.raises(UsageError, match="no lanelets"):
            open_drives(str(tmp_path / "00_tracks.csv")).recording("1")


class TestIndOnANetwork:
    """Scenes with verdicts by hand (``intersection_scenes``), in the format of inD beside their map."""

    @pytest.fixture
    def judge_drive(self, tmp_path):
        def judge_drive(rule, cars, finer=1, **more):
            """Return the verdict on the first car's drive, with so many frames for each step of 0.1 s."""
            scene = tmp_path / "map.xml"
            scene.write_text(crossroads(cars, turn=0.7, **more), encoding="utf-8")
            rows = []
            for name, one in open_commonroad(str(scene)).obstacles.items():
                frames = np.arange((len(one.steps) - 1) * finer + 1)
                x, y, heading, speed = (np.interp(frames / finer, one.steps, row) for row in one.states)
                columns = (x, y, np.degrees(heading), speed * np.cos(heading), speed * np.sin(heading))
                for f, *(x, y, degrees, vx, vy) in zip(frames, *columns, strict=True):
                    rows.append(f"0,{name},{f},{x},{y},{degrees},1.8,4.5,{vx},{vy},0,0")
            scene.write_text(crossroads([drives(3, "right", 0.0)], turn=0.7, **more), encoding="utf-8")
            tracks = write_ind(tmp_path, rows, 10 * finer)
            return judge(rule, open_drives(tracks, None, str(scene)).recording("1"))

        return judge_drive

    @pytest.mark.parametrize("title", RIGHT_OF_WAY)
    def test_right_of_way(self, judge_drive, title):
        rule, cars, more, kept = RIGHT_OF_WAY[title]
        violated, robustness = judge_drive(rule, cars, **more)
        assert violated == (kept is False)
        assert (robustness == math.inf) == (kept is None)

    @pytest.mark.parametrize(("seconds", "violated"), [(3.5, False), (2.0, True)])
    def test_stop_sign(self, judge_drive, seconds, violated):
        car = stops(SOUTH, "straight", 49.25, seconds)
        assert judge_drive("R_IN1", [car], signs={SOUTH: "206"})[0] == violated

    @pytest.mark.parametrize(("cycle", "violated"), [("13 red 90 green", True), ("12 red 90 green", False)])
    def test_lights_keep_their_own_step(self, judge_drive, cycle, violated):
        # the front is on the line at 1.22 s: of 20 frames a second it covers it at that of 1.25 s
        assert judge_drive("R_IN2", [EGO], finer=2, lights=cycle)[0] == violated

    def test_a_network_that_refers_to_nothing_is_named(self, tmp_path):
        text = crossroads([EGO, drives(EAST, "straight", 40.0)], signs=PRIORITY, **RED)
        changed = text.replace('incomingLanelet ref="101"', 'incomingLanelet ref="7"')
        (tmp_path / "map.xml").write_text(changed)
        with pytest.raises(UsageError, match=r"map\.xml: intersection 950 has the incoming lanelet 7"):
            open_drives(write_ind(tmp_path, ["0,1,0,0,0,0,1.8,4.5,9,0,0,0"]), None, str(tmp_path / "map.xml"))
