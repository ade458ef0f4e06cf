"""Truths keep the lower tail of the robustness, exactly; a run that is stopped goes on."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from studies import truth  # noqa: E402

TANK = """\
name: tank
steps: 20
simulator: {plugin: tank}
specifications:
  dry: {stl: "always (level < 2)"}
  low: {stl: "always (level < 1.9)"}
"""


@pytest.fixture
def values():
    values = np.random.default_rng(2).normal(size=20_000)
    values[[5, 77]] = np.nan
    return values


def test_a_tail_knows_every_probability_below_its_end(values):
    tail = truth.Tail.of(values)
    assert (len(tail.robustness), tail.rollouts) == (20, 19_998)
    np.testing.assert_array_equal(values[tail.particle], tail.robustness)
    for threshold in (*tail.robustness[:-1], -3.5, -9.0):
        probability, (low, high) = tail.probability(threshold)
        assert probability == np.nanmean(np.where(np.isnan(values), np.nan, values <= threshold))
        assert low <= probability <= high
    assert tail.threshold(5e-4) == np.sort(values)[9]
    with pytest.raises(ValueError, match="above the tail"):
        tail.probability(0.0)
    with pytest.raises(ValueError, match="not in the tail"):
        tail.threshold(0.01)


@pytest.mark.slow
def test_a_stopped_truth_goes_on_to_the_same_numbers(tmp_path):
    scenario = tmp_path / "tank.yaml"
    scenario.write_text(TANK)
    call = [
        sys.executable,
        str(ROOT / "benchmarks" / "ground_truth.py"),
        str(scenario),
        "--rollouts",
        "110000",
    ]

    def run(name, *words):
        folders = ["--results", str(tmp_path / name), "--truths", str(tmp_path / f"{name}-truths")]
        done = subprocess.run([*call, *folders, *words], capture_output=True, text=True, check=True)
        return done.stdout, sorted((tmp_path / f"{name}-truths").glob("*"))

    said, files = run("stopped", "--workers", "1", "--seconds", "0")
    assert "the same command goes on" in said
    assert files == []
    assert list((tmp_path / "stopped").rglob("*.npz"))
    _, files = run("stopped", "--workers", "2")
    _, others = run("whole", "--workers", "1")
    assert [path.name for path in files] == [path.name for path in others]
    one, other = (json.loads(paths[0].read_text()) for paths in (files, others))
    assert one | {"command": ""} == other | {"command": ""}
    assert [entry["rollouts"] for entry in one["estimates"]] == [110_000, 110_000]
    for name, tail in truth.read_tails(files[0]).items():
        assert (len(tail.robustness), tail.rollouts) == (110, 110_000)  # more than a result keeps
        np.testing.assert_array_equal(tail.robustness, truth.read_tails(others[0])[name].robustness)
