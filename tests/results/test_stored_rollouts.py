"""Stored failures: written whole, read back to the bit, driven again."""

import json
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare.results.recordings import replay_run_failure
from avrare.results.run import Run
from avrare.results.stored_results import read_failures
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change_published.yaml")
WORDS = ["--set", "steps=8", "--set", "estimator.rollouts=10", "--no-pictures", "--json"]
WORDS += ["--set", "simulator.vehicles=[{name: parked, x: 40.0, y: 1.75}]"]
SPECIFICATIONS = (
    "specifications={near: {stl: 'always (gap > 1.98)'}, far: {stl: 'always (gap > -1)'},"
    " middle.x: {stl: 'always (ego_y < 4.499)'}}"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run in which one specification fails often, one sometimes, one never."""
    folder = tmp_path_factory.mktemp("run")
    assert main(["run", LANE_CHANGE, *WORDS, "--set", SPECIFICATIONS, "--out", str(folder)]) == 0
    return folder


def counts(folder):
    content = json.loads((folder / "result.json").read_text())
    return {entry["specification"]: entry["failures"] for entry in content["estimates"]}


def test_failures_are_stored_for_each_specification(folder):
    stored = read_failures(folder)
    expected = {name: count for name, count in counts(folder).items() if count}
    assert {name: failures.count for name, failures in stored.items()} == expected
    assert set(expected) == {"near", "middle.x"}
    for failures in stored.values():
        assert failures.noise.shape[:2] == (failures.count, 9)
        assert (failures.robustness <= 0.0).all()
    assert not [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_the_stored_scenario_is_the_scenario(folder):
    content = json.loads((folder / "result.json").read_text())
    assert fingerprint(load(folder / "scenario.yaml")) == content["fingerprint"]


def test_a_failure_is_replayed_bit_for_bit(folder):
    failures = read_failures(folder)["near"]
    found = replay_run_failure(Run.read(folder), "near", None)
    assert found.changes == ()
    assert found.index == np.argmin(failures.robustness)
    gap = found.recording.signals["gap"]
    assert gap.shape == (9,)
    assert gap.min() - 1.98 == failures.robustness.min()
    other = replay_run_failure(Run.read(folder), "near", 1)
    assert other.recording.signals["gap"].min() - 1.98 == failures.robustness[1]


def test_another_robustness_is_named(folder, tmp_path):
    for name in ("scenario.yaml", "failures.npz", "result.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with np.load(tmp_path / "failures.npz") as stored:
        arrays = dict(stored)
    arrays["near.robustness"][1] -= 1.0
    np.savez(tmp_path / "failures.npz", **arrays)
    found = replay_run_failure(Run.read(tmp_path), "near", None)
    assert found.index == 1
    [message] = found.changes
    assert message.startswith("failure 1 of near: robustness ")
    assert replay_run_failure(Run.read(tmp_path), "near", 0).changes == ()


@pytest.mark.parametrize(
    ("specification", "index", "message", "hint"),
    [
        ("nears", None, "unknown specification 'nears'", "did you mean 'near'?"),
        ("far", None, "no failure of far is stored", "stored: near"),
        (None, None, "several specifications have failures", "choose a specification: near"),
        ("near", 99, "near has no failure 99", "numbered from 0"),
        ("near", -1, "near has no failure -1", "numbered from 0"),
    ],
)
def test_a_missing_failure(folder, specification, index, message, hint):
    with pytest.raises(UsageError) as caught:
        replay_run_failure(Run.read(folder), specification, index)
    assert message in caught.value.message
    assert hint in caught.value.hint
