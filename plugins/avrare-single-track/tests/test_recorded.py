"""Recorded scenes as scenarios: road, ego and traffic are those of the file."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from avrare import Problem, stl
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare.driving import Lane, Road
from avrare.driving.lanes import ENDLESS
from avrare.stack.closed_loop import ClosedLoop
from avrare_recordings.formats.commonroad import open_commonroad
from avrare_single_track.driver_model import idm
from avrare_single_track.file_config import RecordedConfig
from avrare_single_track.recorded import RecordedScene, continue_lanes, has_constant_lanes
from drivers import drive
from intersection_scenes import EAST, EGO, SOUTH, crossroads, drives
from lanelet_scenes import KINDS


@pytest.fixture
def write(tmp_path):
    def write(kind, turn=0.7):
        path = tmp_path / f"{kind}.xml"
        path.write_text(KINDS[kind](turn), encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize("kind", KINDS)
def test_the_ego_starts_where_car_1_was_and_the_others_are_where_they_were(write, kind):
    path = write(kind)
    sim = RecordedScene(RecordedConfig(file=path, without=(1,)))
    recording = open_commonroad(str(path)).recording("1")
    world = sim.reset(np.zeros((2, 0)))
    for name in ("x", "y", "heading", "speed"):
        np.testing.assert_allclose(getattr(world.ego, name), recording.signals[f"ego_{name}"][0], atol=0.3)
    assert sim.scene.names == tuple(f"v{name}" for name in recording.names)
    for step in (0, 15, 39):
        found = sim.traffic.at(np.full(2, step))
        for name in ("x", "y", "speed"):
            expected = recording.signals[f"others_{name}"][step]
            np.testing.assert_allclose(getattr(found, name)[0], expected, atol=0.3)


@pytest.mark.parametrize("command", [["validate", "--build"], ["run"]])
def test_steps_beyond_the_recording_are_refused_with_its_end(write, command, tmp_path, monkeypatch, capsys):
    path = write("bend")
    simulator = f"{{plugin: commonroad, file: {path.name}, without: [1]}}"
    (tmp_path / "scene.yaml").write_text(
        f"name: scene\nsteps: 40\nsimulator: {simulator}\n"
        'specifications: {clear: {stl: "always (gap > 2.0)"}}\n'
    )
    monkeypatch.chdir(tmp_path)
    assert main([*command, "scene.yaml"]) == 4
    error = capsys.readouterr().err
    assert "scene.yaml: steps: " in error
    assert "bend.xml: the recording ends 3.9 s after the start, at step 39, but a rollout has 40" in error
    assert "hint: set `steps: 39`, or fewer" in error
    sim = RecordedScene(RecordedConfig(file=path, without=(1,)))
    Problem(ClosedLoop(sim), stl("always (gap > 2.0)"), 39)
    with pytest.raises(UsageError, match="at step 39"):
        Problem(ClosedLoop(sim), stl("always (gap > 2.0)"), 40)


def test_a_vehicle_in_the_ego_s_place_is_named(write, caplog):
    path = write("bend")
    RecordedScene(RecordedConfig(file=path))
    assert f"{path}: obstacle 1 is where the ego starts" in caplog.text
    assert "`without: [1]`" in caplog.text


def test_mistakes(write):
    path = write("bend")
    with pytest.raises(UsageError, match="no planning problem 3") as caught:
        RecordedScene(RecordedConfig(file=path, problem=3))
    assert "there are: 9999" in caught.value.hint
    with pytest.raises(UsageError, match="no obstacle 77"):
        RecordedScene(RecordedConfig(file=path, without=(77,)))
    with pytest.raises(UsageError, match="speed must not be above speed_max"):
        RecordedScene(RecordedConfig(file=path, ego={"speed_max": 3.0}))


@pytest.mark.parametrize(
    ("ego", "words"),
    [
        ({"speed": 3.0}, r"ego\.speed is that of the recording: leave it out"),
        ({"lenght": 4.0}, r"ego\.lenght: unknown key; did you mean 'length'"),
        ({"length": -4.0}, r"ego\.length: Input should be greater than 0"),
    ],
)
def test_the_ego_s_options_are_checked_before_anything_is_built(ego, words):
    with pytest.raises(ValidationError, match=words):
        RecordedConfig(file="scene.xml", ego=ego)


def test_a_start_that_is_not_exact_is_refused(write):
    path = write("bend")
    text = path.read_text(encoding="utf-8")
    head, start = text.split("<planningProblem", 1)
    for tag, value in (
        ("position", "<circle><radius>1.0</radius><center><x>0.0</x><y>0.0</y></center></circle>"),
        ("position", "<point><x>nan</x><y>0.0</y></point>"),
        ("velocity", "<intervalStart>1.0</intervalStart><intervalEnd>2.0</intervalEnd>"),
    ):
        changed = re.sub(f"<{tag}>.*?</{tag}>", f"<{tag}>{value}</{tag}>", start, count=1, flags=re.DOTALL)
        path.write_text(f"{head}<planningProblem{changed}", encoding="utf-8")
        with pytest.raises(UsageError, match="planning problem 9999 has no exact position"):
            RecordedScene(RecordedConfig(file=path))


def roll(sim, steps):
    return drive(sim, steps)[-1]


def test_cars_that_were_handed_over_react_from_where_they_were(write):
    path = write("bend", 0.0)
    head, problem = path.read_text(encoding="utf-8").split("<planningProblem", 1)
    problem = re.sub(r"<x>.*?</x>", "<x>59.0</x>", problem, count=1)  # 2.5 m ahead of car 2
    path.write_text(f"{head}<planningProblem{problem}", encoding="utf-8")
    replayed = RecordedScene(RecordedConfig(file=path, without=(1,)))
    handed = RecordedScene(RecordedConfig(file=path, without=(1,), drivers={"vehicles": (2,)}))
    assert handed.noise_names == ("acceleration of v2",)
    noise = np.zeros((1, 1))
    for name in ("x", "y", "speed"):
        starts = (sim.reset(noise[:, : sim.noise_size]).others for sim in (replayed, handed))
        np.testing.assert_array_equal(*(getattr(others, name) for others in starts))
    before, after = roll(replayed, 10), roll(handed, 10)
    assert before.others.speed[0, 0] == pytest.approx(25.0)
    gap = 7.0 - 0.5 * (handed.scene.ego_length + handed.scene.lengths[0])
    table = np.array([25.0, 1.5, 2.0, 1.5, 2.0, 8.0])
    first = roll(handed, 1).others.acceleration[0, 0]
    assert first == pytest.approx(idm(25.0, 25.0, gap, table), rel=1e-3)
    assert after.others.x[0, 0] < before.others.x[0, 0] - 1.0
    np.testing.assert_array_equal(before.others.x[:, 1], after.others.x[:, 1])  # not handed over


def test_cars_that_cannot_be_handed_over(write):
    with pytest.raises(UsageError, match="lanes of constant widths"):
        RecordedScene(RecordedConfig(file=write("widening"), drivers={}))
    path, begin = write("bend"), r'(<dynamicObstacle id="3">.*?<time><exact>)0'
    late = re.sub(begin, r"\g<1>1", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    path.write_text(late, encoding="utf-8")
    with pytest.raises(UsageError, match="obstacle 3 is not there at the start") as caught:
        RecordedScene(RecordedConfig(file=path, without=(1,), drivers={"vehicles": (3,)}))
    assert caught.value.hint == "drivers.vehicles may name: 2"


def test_oncoming_cars_that_were_handed_over_keep_coming(write):
    sim = RecordedScene(RecordedConfig(file=write("opposing"), without=(1,), drivers={"vehicles": (3,)}))
    before, after = roll(sim, 0), roll(sim, 20)
    way = after.others.x[0, 1] - before.others.x[0, 1]
    speeds = before.others.speed[0, 1], after.others.speed[0, 1]
    assert way < -1.9 * min(speeds)
    assert after.others.y[0, 1] == pytest.approx(before.others.y[0, 1])
    assert np.cos(after.others.heading[0, 1]) < -0.99


def test_a_map_s_end_is_no_end_of_a_lane_but_an_earlier_end_is():
    lanes = tuple(
        Lane(np.array([0.0, end]), np.full(2, y - 1.75), np.full(2, y + 1.75))
        for y, end in ((-1.75, 120.0), (1.75, 299.5))
    )
    road = continue_lanes(Road((-1.75, 1.75), 3.5, begin=0.0, end=300.0, lanes=lanes))
    ends = [tuple(lane.stations[[0, -1]]) for lane in road.lanes]
    assert ends == [(-ENDLESS, 120.0), (-ENDLESS, ENDLESS)]
    assert has_constant_lanes(road)


def test_crossing_cars_are_not_handed_over(tmp_path):
    path = tmp_path / "crossroads.xml"
    cars = [EGO, drives(EAST, "straight", 52.0), drives(SOUTH, "straight", 20.0)]
    path.write_text(crossroads(cars), encoding="utf-8")
    sim = RecordedScene(RecordedConfig(file=path, without=(1,), drivers={}))
    assert sim.noise_names == ("acceleration of v3",)
    before, after = roll(sim, 0), roll(sim, 10)
    assert abs(after.others.y[0, 0] - before.others.y[0, 0]) == pytest.approx(8.0)  # at 8 m/s across
    assert after.others.x[0, 0] == pytest.approx(before.others.x[0, 0])
    with pytest.raises(UsageError, match=r"obstacle 2 .* not along a lane of the ego's road") as caught:
        RecordedScene(RecordedConfig(file=path, without=(1,), drivers={"vehicles": (2,)}))
    assert caught.value.hint == "drivers.vehicles may name: 3"
