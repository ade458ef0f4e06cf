"""Rollouts as files that ``avrare monitor`` reads."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from avrare.base.errors import PluginError
from avrare.results.recordings import FIELDS, Recording
from avrare.rollout.replay import extract_frames, replay_tape, replay_tapes
from avrare_recordings.formats.commonroad import read_commonroad, to_commonroad
from avrare_recordings.formats.csv_recording import csv_vehicle_names, read_csv, to_csv
from avrare_recordings.formats.mcap_recording import write_mcap
from avrare_recordings.formats.rerun_recording import write_rerun


@pytest.fixture(scope="module")
def recording(drive_past):
    tape = np.random.default_rng(0).standard_normal((9, 4))
    found = replay_tape(drive_past.problem("near"), tape)
    return Recording("test", 0.1, 0.0, found.signals, drive_past.scene, drive_past.scene.names)


def test_vehicles_in_csv_are_read_back_bit_for_bit(recording, tmp_path):
    (tmp_path / "drive.csv").write_text(to_csv(recording))
    again = read_csv(str(tmp_path / "drive.csv"), "ego", recording.scene.road)
    assert (again.dt, again.names) == (recording.dt, recording.names)
    for name in (f"{who}_{field}" for who in ("ego", "others") for field in FIELDS):
        np.testing.assert_array_equal(again.signals[name], recording.signals[name])
    np.testing.assert_array_equal(again.signals["gap"], recording.signals["gap"])


def test_another_vehicle_named_ego_is_renamed(recording, tmp_path):
    assert csv_vehicle_names(("ego_2", "ego", "van")) == ("ego_2", "ego_3", "van")
    assert csv_vehicle_names(("van", "Ego")) == ("van", "Ego")
    named = replace(recording, scene=replace(recording.scene, names=("ego",)), names=("ego",))
    (tmp_path / "drive.csv").write_text(to_csv(named))
    again = read_csv(str(tmp_path / "drive.csv"), "ego", recording.scene.road)
    assert again.names == ("ego_2",)
    for name in (f"{who}_{field}" for who in ("ego", "others") for field in FIELDS):
        np.testing.assert_array_equal(again.signals[name], recording.signals[name])


def test_signals_in_csv_are_read_back_bit_for_bit(linear, pushed, tmp_path):
    found = replay_tape(linear.problem("near"), pushed)
    (tmp_path / "drive.csv").write_text(to_csv(Recording("test", 0.1, 0.0, found.signals)))
    again = read_csv(str(tmp_path / "drive.csv"))
    assert again.dt == 0.1
    for name, values in found.signals.items():
        np.testing.assert_array_equal(again.signals[name], values)


def test_commonroad_is_read_back_bit_for_bit(recording, tmp_path):
    (tmp_path / "drive.xml").write_text(to_commonroad(recording, "past a parked car"))
    again = read_commonroad(str(tmp_path / "drive.xml"), "1")
    assert (again.dt, again.names, again.samples) == (0.1, ("2",), 9)
    for who in ("ego", "others"):
        for field in ("x", "y", "speed"):
            np.testing.assert_array_equal(
                again.signals[f"{who}_{field}"], recording.signals[f"{who}_{field}"]
            )
        headings = [one.signals[f"{who}_heading"] for one in (again, recording)]
        np.testing.assert_allclose(*headings, rtol=0.0, atol=1e-12)
    road, before = again.scene.road, recording.scene.road
    assert road.lane_centres == pytest.approx(before.lane_centres)
    assert (road.lane_width, road.access_ramp) == (before.lane_width, before.access_ramp)


def test_replays_in_a_batch_equal_single_replays(linear, pushed, drive_past):
    tapes = np.stack([factor * pushed for factor in (0.0, 0.5, 1.0, -1.0)])
    noise = np.random.default_rng(1).standard_normal((3, 9, 4))
    for problem, batch in ((linear.problem("near"), tapes), (drive_past.problem("near"), noise)):
        for tape, together in zip(batch, replay_tapes(problem, batch), strict=True):
            alone = replay_tape(problem, tape)
            assert (alone.robustness, alone.outcome) == (together.robustness, together.outcome)
            for name, values in alone.signals.items():
                np.testing.assert_array_equal(together.signals[name], values, strict=True)


def test_a_rollout_that_breaks_down_keeps_its_beginning(weighted):
    problem = weighted(np.ones((6, 3)), nan=5.0)
    noise = np.zeros((3, 6, 3))
    noise[1, 4, 0] = 6.0
    noise[2, 0, 0] = 6.0
    found = replay_tapes(problem, noise)
    assert [one.outcome for one in found] == ["passes", "error", "error"]
    assert [len(one.signals.get("x", ())) for one in found] == [6, 4, 0]
    assert "NaN" in found[1].error


def messages(path, topic):
    from mcap.reader import make_reader

    with path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=[topic])
        return [(schema.name, message.log_time, json.loads(message.data)) for schema, _, message in found]


def test_mcap_has_boxes_and_signals_at_every_sample(drive_past, recording, tmp_path):
    tape = np.random.default_rng(0).standard_normal((9, 4))
    rollout = replay_tape(drive_past.problem("near"), tape)
    write_mcap(tmp_path / "drive.mcap", recording, extract_frames(drive_past.problem("near"), rollout))
    scene = messages(tmp_path / "drive.mcap", "/scene")
    assert {name for name, _, _ in scene} == {"foxglove.SceneUpdate"}
    assert [time for _, time, _ in scene] == [100_000_000 * k for k in range(9)]
    cubes = {one["id"]: one["cubes"][0] for one in scene[3][2]["entities"]}
    assert set(cubes) == {"ego", *recording.scene.names}
    assert cubes["ego"]["pose"]["position"]["x"] == recording.signals["ego_x"][3]
    assert cubes["ego"]["size"]["x"] == recording.scene.ego_length
    signals = messages(tmp_path / "drive.mcap", "/signals")
    assert [content["gap"] for _, _, content in signals] == recording.signals["gap"].tolist()
    (road,) = messages(tmp_path / "drive.mcap", "/road")
    assert len(road[2]["entities"][0]["lines"]) >= 2


def test_mcap_without_vehicles_has_signals_only(linear, pushed, tmp_path):
    found = replay_tape(linear.problem("near"), pushed)
    signals = {**found.signals, "endless": np.full(len(found.states), np.inf)}
    write_mcap(tmp_path / "drive.mcap", Recording("test", 0.1, 0.0, signals), ())
    rows = messages(tmp_path / "drive.mcap", "/signals")
    assert len(rows) == len(found.states)
    assert rows[0][2]["endless"] is None  # JSON has no infinity
    assert not messages(tmp_path / "drive.mcap", "/scene")


def test_rerun_that_is_not_installed_is_an_extra(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(PluginError) as caught:
        write_rerun(tmp_path / "drive.rrd", recording, ())
    assert caught.value.hint == "pip install 'avrare-recordings[rerun]'"
