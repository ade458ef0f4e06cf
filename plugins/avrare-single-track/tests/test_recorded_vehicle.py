"""Recordings as scenarios in which the ego stands for one of the vehicles: CommonRoad, highD, inD."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.base.errors import AvrareError, UsageError
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from avrare_recordings.formats.commonroad import open_commonroad
from avrare_recordings.formats.drives import open_drives
from avrare_single_track.file_config import RecordedConfig
from avrare_single_track.recorded import RecordedScene
from drivers import drive
from drone_files import highd_rows, write_highd, write_ind
from lanelet_scenes import KINDS


@pytest.fixture
def highd(tmp_path):
    rows = [
        *highd_rows(1, 50.0, 26.0, 30.0, range(10, 110)),  # lower, right lane
        *highd_rows(2, 90.0, 26.0, 20.0, range(110)),  # ahead of it, slower
        *highd_rows(3, 70.0, 22.0, 25.0, range(60)),  # left lane, gone after 2 s
        *highd_rows(4, 300.0, 10.0, 25.0, range(110), -1.0),  # the other way
    ]
    return write_highd(tmp_path, rows, {1: 2, 2: 2, 3: 2, 4: 1})


def roll(sim, steps):
    """Return the world after some steps, the ego going straight on."""
    worlds = drive(sim, steps)
    assert not any(sim.faults(world).any() for world in worlds)
    return worlds[-1]


def test_the_ego_stands_for_a_vehicle_of_highd(highd):
    sim = RecordedScene(RecordedConfig(file=highd, vehicle=1))
    recording = open_drives(highd).recording("1")
    assert (sim.dt, sim.last, sim.scene.names) == (0.04, 99, ("v2", "v3"))
    world = sim.reset(np.zeros((1, 0)))
    for name in ("x", "y", "heading", "speed"):
        assert getattr(world.ego, name)[0] == recording.signals[f"ego_{name}"][0]
    for step in (0, 30, 99):
        found = sim.traffic.at(np.array([step]))
        np.testing.assert_array_equal(found.x[0], recording.signals["others_x"][step])


def test_vehicles_of_highd_are_handed_to_drivers(tmp_path):
    rows = [*highd_rows(1, 50.0, 26.0, 30.0, range(110)), *highd_rows(2, 90.0, 26.0, 20.0, range(110))]
    highd = write_highd(tmp_path, rows, {1: 2, 2: 2})
    sim = RecordedScene(RecordedConfig(file=highd, vehicle=2, dt=0.1, drivers={"vehicles": (1,)}))
    assert sim.noise_names == ("acceleration of v1",)
    passing = RecordedConfig(file=highd, vehicle=2, dt=0.1, after_impact="go_on")
    replayed = roll(RecordedScene(passing), 43)
    driven = roll(sim, 43)
    k = sim.scene.names.index("v1")
    assert replayed.others.x[0, k] > replayed.ego.x[0]  # 10 m/s faster, it drives through the ego
    assert driven.others.x[0, k] + 4.5 < driven.ego.x[0]
    assert driven.others.speed[0, k] < 29.0


def test_the_ego_stands_for_a_vehicle_of_ind_on_a_network(tmp_path):
    rows = [f"0,7,{f},{20 + 0.4 * f},1.75,0,1.8,4.0,10,0,0,0" for f in range(60)]
    rows += [f"0,8,{f},{60 + 0.4 * f},1.75,0,1.8,4.5,10,0,0,0" for f in range(60)]
    path = write_ind(tmp_path, rows)
    lanes = tmp_path / "map.xml"
    lanes.write_text(KINDS["crossing"](0.0), encoding="utf-8")
    sim = RecordedScene(RecordedConfig(file=path, vehicle=7, network=lanes, dt=0.2))
    world = roll(sim, sim.last)
    assert world.ego.x[0] - sim.reset(np.zeros((1, 0))).ego.x[0] == pytest.approx(10.0 * 0.2 * sim.last)
    assert sim.scene.ego_length == 4.0
    with pytest.raises(UsageError, match="there are no lanelets"):
        RecordedScene(RecordedConfig(file=path, vehicle=7))


def test_lanes_are_given_to_recordings_without_them_only(highd, tmp_path):
    lanes = tmp_path / "map.xml"
    lanes.write_text(KINDS["bend"](0.0), encoding="utf-8")
    for path in (highd, lanes):
        with pytest.raises(UsageError, match="`network` is of a recording in the format of inD"):
            RecordedScene(RecordedConfig(file=path, vehicle=1, network=lanes))


@pytest.mark.parametrize("dt", [None, 0.1])
def test_a_vehicle_with_a_gap_while_the_ego_drives_is_left_out(tmp_path, dt):
    rows = [
        *highd_rows(1, 50.0, 26.0, 30.0, range(10, 60)),
        *highd_rows(2, 90.0, 26.0, 20.0, [*range(5), *range(80, 90)]),
        *highd_rows(3, 95.0, 22.0, 20.0, range(60)),
    ]
    highd = write_highd(tmp_path, rows, {1: 2, 2: 2, 3: 2})
    assert RecordedScene(RecordedConfig(file=highd, vehicle=1, dt=dt)).scene.names == ("v3",)


def test_a_result_depends_on_the_files_that_complete_a_recording(highd, tmp_path):
    (tmp_path / "s.yaml").write_text(
        f"name: s\nsteps: 3\nsimulator: {{plugin: commonroad, file: {highd}, vehicle: 1}}\n"
        'specifications: {clear: {stl: "always (gap > 2.0)"}}\n'
    )
    before = fingerprint(load(tmp_path / "s.yaml"))
    for name in ("01_recordingMeta.csv", "01_tracksMeta.csv"):
        text = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text.replace("25", "20").replace("4.5", "4.6"))
        assert fingerprint(load(tmp_path / "s.yaml")) != before
        (tmp_path / name).write_text(text)
    assert fingerprint(load(tmp_path / "s.yaml")) == before


def test_safe_mode_reads_no_linked_file_beside_a_recording(highd, tmp_path, monkeypatch):
    folder = tmp_path / "given"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for name in ("tracks", "tracksMeta"):
        (folder / f"01_{name}.csv").write_text((tmp_path / f"01_{name}.csv").read_text())
    (folder / "01_recordingMeta.csv").symlink_to(tmp_path / "01_recordingMeta.csv")
    path = folder / "s.yaml"
    path.write_text(
        "name: s\nsteps: 3\nsimulator: {plugin: commonroad, file: 01_tracks.csv, vehicle: 1}\n"
        'specifications: {clear: {stl: "always (gap > 2.0)"}}\n'
    )
    load(path)
    words = r"01_recordingMeta\.csv'? is a link to a file outside"
    with safe_mode(), pytest.raises(AvrareError, match=words):
        load(path)
    (folder / "01_recordingMeta.csv").unlink()
    (folder / "01_recordingMeta.csv").write_text((tmp_path / "01_recordingMeta.csv").read_text())
    with safe_mode():
        load(path)


def test_a_scene_of_format_2024_has_its_map_and_its_problems_beside_it(tmp_path):
    for name in ("ZAM_A-1", "ZAM_A-1_1_T-1", "ZAM_A-1_1_T-1-SC", "ZAM_B-1"):
        (tmp_path / f"{name}.pb").touch()
    used = RecordedConfig(file=tmp_path / "ZAM_A-1_1_T-1-SC.pb").used_files()
    assert [path.stem for path in used.values()] == ["ZAM_A-1", "ZAM_A-1_1_T-1"]
    assert not RecordedConfig(file=tmp_path / "nowhere.pb").used_files()


@pytest.mark.parametrize("kind", KINDS)
def test_the_ego_stands_for_an_obstacle_of_commonroad(tmp_path, kind):
    path = tmp_path / f"{kind}.xml"
    path.write_text(KINDS[kind](0.7), encoding="utf-8")
    sim = RecordedScene(RecordedConfig(file=path, vehicle=1))
    recording = open_commonroad(str(path)).recording("1")
    assert sim.scene.names == tuple(f"v{name}" for name in recording.names)
    world = sim.reset(np.zeros((1, 0)))
    assert math.hypot(*(getattr(world.ego, c)[0] - recording.signals[f"ego_{c}"][0] for c in "xy")) < 1e-9


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicle": 9}, "there is no moving vehicle 9"),
        ({"vehicle": 1, "without": (8,)}, "there is no obstacle 8"),
        ({"vehicle": 1, "dt": 1.0, "drivers": {"vehicles": (4,)}}, "obstacle 4 is not there at the start"),
    ],
)
def test_vehicles_that_are_not_there(highd, options, message):
    with pytest.raises(UsageError, match=message):
        RecordedScene(RecordedConfig(file=highd, **options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicle": 1, "problem": 2}, "problem is of a planning problem"),
        ({"network": "a"}, "is of a `vehicle`"),
        ({"vehicle": 1, "dt": 1e-9}, "greater than or equal to 0.001"),
    ],
)
def test_options_that_are_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        RecordedConfig(file="a.xml", **options)
