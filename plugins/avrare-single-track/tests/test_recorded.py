"""Recorded scenes as scenarios: road, ego and traffic are those of the file."""

import re

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Action
from avrare.results.recordings.commonroad import open_commonroad
from avrare_single_track.config import RecordedConfig
from avrare_single_track.recorded import RecordedScene
from lanelet_scenes import KINDS

pytest.importorskip("commonroad.common.file_reader")


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


def test_it_drives_until_the_recording_ends(write):
    sim = RecordedScene(RecordedConfig(file=write("bend"), ego={"friction": 1.0, "length": 4.0}))
    assert sim.scene.ego_length == 4.0
    world = sim.reset(np.zeros((2, 0)))
    for step in range(1, 42):
        world = sim.step(world, Action(np.zeros(2), np.zeros(2)), np.zeros((2, 0)))
        assert sim.faults(world).any() == (step > 39)
    assert set(sim.signals(world)) >= {"ego_x", "others_x", "gap"}


def test_mistakes(write):
    path = write("bend")
    with pytest.raises(UsageError, match="no planning problem 3") as caught:
        RecordedScene(RecordedConfig(file=path, problem=3))
    assert "there are: 9999" in caught.value.hint
    with pytest.raises(UsageError, match="no obstacle 77"):
        RecordedScene(RecordedConfig(file=path, without=(77,)))
    with pytest.raises(UsageError, match=r"ego\.speed is that of the planning problem"):
        RecordedScene(RecordedConfig(file=path, ego={"speed": 3.0}))
    for ego, words in (({"lenght": 4.0}, r"ego\.lenght"), ({"length": -4.0}, r"ego\.length")):
        with pytest.raises(UsageError, match=words) as caught:
            RecordedScene(RecordedConfig(file=path, ego=ego))
        assert caught.value.hint == ("did you mean 'length'?" if "lenght" in ego else None)


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
