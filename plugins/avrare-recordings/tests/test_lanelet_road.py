"""Roads of lanelet networks: bends, merges, opposing lanes, crossings; verdicts worked out by hand."""

import re

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.driving.lanes import lane_borders
from avrare_recordings.batch import Question, monitor_files
from avrare_recordings.drive_monitor import monitor
from avrare_recordings.formats.commonroad import open_commonroad
from judged_recordings import judge
from lanelet_scenes import BEND, KINDS, STRAIGHT, bend, car, carriageway, crossing, merge, opposing, scene


@pytest.fixture
def drives(tmp_path):
    def write(text):
        path = tmp_path / "scene.xml"
        path.write_text(text, encoding="utf-8")
        return open_commonroad(str(path))

    return write


def robustness(name, recording):
    return judge(name, recording)[1]


class TestRoads:
    def test_a_bend_has_its_lanes_at_every_angle(self, drives):
        for turn in (0.0, 2.0, -3.0):
            recording = drives(bend(turn)).recording("3")
            road = recording.scene.road
            assert road.lane_centres == pytest.approx((0.0, 3.5, 7.0), abs=0.01)
            right, left = lane_borders(road, np.array([50.0, 150.0, 250.0]))
            np.testing.assert_allclose(left - right, 3.5, atol=0.01)
            y = recording.signals["ego_y"]
            assert (y[0], y[-1]) == (pytest.approx(0.0, abs=0.02), pytest.approx(3.5, abs=0.02))
            assert np.abs(recording.signals["ego_heading"]).max() < 0.1

    def test_opposing_lanes(self, drives):
        for turn in (0.0, 1.0):
            found = drives(opposing(turn))
            forth, back = found.recording("1"), found.recording("3")
            assert forth.scene.road.opposing == (1,)
            assert back.scene.road.opposing == (1,)  # to the left of whoever drives
            assert abs(abs(forth.signals["others_heading"][0, 1]) - np.pi) < 0.05
            assert back.signals["ego_x"][-1] > back.signals["ego_x"][0]

    def test_a_ramp_ends_where_it_merges(self, drives):
        road = drives(merge()).recording("3").scene.road
        assert road.access_ramp == (0,)
        assert road.lanes[0].stations[-1] == pytest.approx(100.0, abs=1.0)
        assert road.lanes[1].stations[-1] == pytest.approx(BEND.length, abs=3.0)

    def test_a_crossing_road_is_no_lane(self, drives):
        for turn in (0.0, 0.4):
            road = drives(crossing(turn)).recording("1").scene.road
            assert len(road.lane_centres) == 1

    def test_straight_parallel_lanes_stay_what_they_were(self, drives):
        text = scene(STRAIGHT, carriageway(STRAIGHT, 2), [car(STRAIGHT, 1, 20.0, 1.75, 20.0)])
        road = drives(text).recording("1").scene.road
        assert road == Road((1.75, 5.25), 3.5, (), 0.0, 300.0)

    def test_markings_and_kinds_of_straight_lanes(self, drives):
        lanes = carriageway(STRAIGHT, 3)
        for lane in lanes:
            lane.kind = "shoulder" if lane.name < 200 else lane.kind
            if 200 <= lane.name < 300:
                lane.markings["left"] = "broad_dashed"
        road = drives(scene(STRAIGHT, lanes, [car(STRAIGHT, 1, 20.0, 5.25, 20.0)])).recording("1").scene.road
        assert (road.shoulder, road.broad_markings) == ((0,), (1,))

    def test_markings_of_bent_lanes(self, drives):
        lanes = carriageway(BEND, 3)
        for one in lanes:
            if one.name >= 300:
                one.markings["right"] = "broad_solid"
        road = drives(scene(BEND, lanes, [car(BEND, 1, 20.0, 5.25, 20.0)])).recording("1").scene.road
        assert road.broad_markings == (1,)

    @pytest.mark.parametrize("kind", KINDS)
    def test_lane_changes_do_not_jump(self, drives, kind):
        found = drives(KINDS[kind](0.7))
        for ego in found.names:
            signals = found.recording(ego).signals
            pace = np.diff(signals["ego_x"]) / 0.1
            assert np.abs(pace - signals["ego_speed"][:-1]).max() < 1.5
            assert np.abs(np.diff(signals["ego_y"])).max() < 0.5


class TestVerdicts:
    """Gaps and speeds of the generated scenes, and the rule's own arithmetic."""

    def test_safe_distance_on_a_bend(self, drives):
        found = drives(bend(2.0))
        # 12 m between centres, 7.5 m of room; needed: 25^2/20 - 25^2/21 + 25 * 0.4 = 11.49 m
        gap = found.recording("1").signals["others_x"][0, 0] - found.recording("1").signals["ego_x"][0] - 4.5
        assert robustness("R_G1", found.recording("1")) == pytest.approx((gap - 11.49) / 10.0, abs=0.06)
        assert robustness("R_G1", found.recording("1")) < 0.0
        assert robustness("R_G1", found.recording("2")) > 0.0

    def test_passing_on_the_right_in_a_bend(self, drives):
        lanes = carriageway(BEND, 2)
        cars = [car(BEND, 1, 100.0, 1.75, 25.0), car(BEND, 2, 105.0, 5.25, 15.0)]
        found = drives(scene(BEND, lanes, cars, 1.0))
        assert robustness("R_I2", found.recording("1")) < 0.0  # beside it, on its right, and 10 m/s faster
        assert robustness("R_I2", found.recording("2")) > 0.0
        for one in lanes:
            if one.name < 200:
                one.markings["left"] = "broad_solid"
        found = drives(scene(BEND, lanes, cars, 1.0))
        assert robustness("R_I2", found.recording("1")) > 0.0  # across a broad marking

    def test_oncoming_traffic_is_passed_lawfully(self, drives):
        found = drives(opposing(0.5))
        assert robustness("R_I2", found.recording("1")) > 0.0
        assert robustness("R_I3", found.recording("3")) > 0.0  # it drives its own way, not against the road

    def test_slow_without_reason(self, drives):
        found = drives(opposing(0.5))
        assert robustness("R_G4", found.recording("2")) == pytest.approx((20.0 - 21.11) / 5.0, abs=1e-3)
        assert robustness("R_G4", found.recording("1")) > 0.0  # behind a slow one

    def test_an_entering_vehicle_is_minded(self, drives):
        found = drives(merge(1.0))
        assert robustness("R_I5", found.recording("3")) > 0.0  # it keeps to the right lane all along


class TestMistakes:
    @pytest.mark.parametrize(
        ("line", "words"), [(BEND, "ego drives on no lanelet"), (STRAIGHT, "in no lane at any time")]
    )
    def test_an_ego_beside_all_lanelets(self, drives, line, words):
        text = scene(line, carriageway(line, 1), [car(line, 1, 20.0, -9.0, 20.0)])
        with pytest.raises(UsageError, match=words):
            drives(text).recording("1")

    def test_a_border_that_leaves_its_lane(self, drives):
        text = scene(BEND, carriageway(BEND, 1), [car(BEND, 1, 20.0, 0.0, 20.0)])
        far = re.sub(r"(<rightBound>.*?<y>)[^<]*", r"\g<1>1e3", text, flags=re.DOTALL)
        with pytest.raises(UsageError, match="no border of the lanelets that the ego drives on"):
            drives(far).recording("1")

    def test_a_road_of_the_callers_where_the_ego_is_on_no_lanelet(self, tmp_path):
        path = tmp_path / "s.xml"
        path.write_text(scene(BEND, carriageway(BEND, 1), [car(BEND, 1, 20.0, -9.0, 20.0)]), encoding="utf-8")
        with pytest.raises(UsageError, match="in no lane at any time") as caught:
            open_commonroad(str(path), Road((900.0,), 3.5)).recording("1")
        assert "different coordinates" in caught.value.hint


def test_other_lanes_than_those_of_the_file_are_refused(tmp_path):
    path, road = tmp_path / "s.xml", Road((-1.75, 1.75, 5.25), 3.5)
    path.write_text(bend(1.5), encoding="utf-8")
    with pytest.raises(UsageError, match="it has lanes of its own") as caught:
        monitor(path, rule="R_G1", ego="1", road=road)
    assert caught.value.hint == "leave out --lanes"
    own = monitor(path, rule="R_G1", ego="1")
    assert own.recording.scene.road.line is not None
    found = monitor_files([str(path)], Question(("R_G1",), road=road, required=True))
    assert not found.scores
    assert "it has lanes of its own" in found.refusals[0].reason
    spared = monitor_files([str(path)], Question(("R_G1",), road=road))
    assert {score.robustness for score in spared.scores} >= {own.robustness}


@pytest.mark.parametrize("line", [STRAIGHT, BEND])
def test_lanelets_with_heights_are_those_without(drives, line):
    text = scene(line, carriageway(line, 2), [car(line, 1, 20.0, 1.75, 20.0)])
    raised = re.sub(r"(?m)^<lanelet .*$", lambda row: row[0].replace("</y><", "</y><z>1.5</z><"), text)
    assert "<z>" in raised
    flat, high = (drives(form).recording("1") for form in (text, raised))
    assert high.scene.road.lane_centres == flat.scene.road.lane_centres
    np.testing.assert_array_equal(high.signals["ego_x"], flat.signals["ego_x"])
