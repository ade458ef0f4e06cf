"""Files of an earlier release, which are still read and say the same."""

import json
import shutil
from pathlib import Path

import pytest

from avrare.cli.main import main

FIRST = Path(__file__).parents[2] / "data" / "first_release"


@pytest.fixture
def first(inside):
    """Return a copy of the first release's files, and the plugins that they need."""
    shutil.copytree(FIRST, inside.folder / "first")
    return inside.folder / "first"


def content(path):
    stored = json.loads(path.read_text())
    for new in ("checksum", "files"):  # the first release did not write them
        stored.pop(new, None)
    for entry in stored["estimates"]:
        del entry["seconds"]
        for new in ("blind_bound", "cross_check"):  # the first release did not write them
            assert entry.pop(new, None) is None
    return stored


def test_the_same_scenario_gives_the_same_result(first):
    assert main(["run", "first/walk.yaml", "--out", "again", "--no-pictures", "--quiet"]) == 0
    assert content(Path("again/result.json")) == content(first / "run" / "result.json")


@pytest.mark.slow
def test_a_killed_run_is_resumed(first):
    assert main(["run", "--resume", "first/night", "--no-pictures", "--quiet"]) == 0
    assert main(["run", "first/night.yaml", "--out", "whole", "--no-pictures", "--quiet"]) == 0
    assert content(first / "night" / "result.json") == content(Path("whole/result.json"))


def test_a_run_folder_is_reported_and_replayed(first, capsys):
    assert main(["report", "first/run"]) == 0
    assert main(["replay", "first/walk.yaml", "--run", "first/run", "--specification", "far"]) == 0
    assert "far is violated, robustness -0.357574" in capsys.readouterr().out


@pytest.mark.slow
def test_a_baseline_is_compared_with(first, capsys):
    words = ["check", "first/walk.yaml", "--baseline", "first/baselines", "--seed", "7", "--json"]
    assert main([*words, "--set", "estimator.rollouts=4000"]) in (0, 3)
    rows = {row["specification"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert (rows["near"]["baseline"], rows["far"]["baseline"]) == (0.025, 0.005)


def test_a_stored_failure_still_fails(first, capsys):
    assert main(["replay", "first/walk.yaml", "--failure", "198c4495", "--failures", "first/failures"]) == 0
    assert "is violated, robustness" in capsys.readouterr().out


def test_a_history_grows(first, capsys):
    assert main(["history", "add", "first/run", "--store", "first/history.sqlite"]) == 0
    assert "0 of 2" in capsys.readouterr().out
    assert main(["history", "walk", "--store", "first/history.sqlite", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)) == 2
