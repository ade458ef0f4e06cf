"""Result callbacks: called with what was written, and powerless over it."""

import json
import sys
from pathlib import Path

import pytest

import avrare
from avrare.cli.main import main
from avrare.plugin.registry import default_registry
from avrare.results import run_folder

TOY = Path(__file__).parents[1] / "analysis" / "check" / "toy"
SCENARIO = """\
name: drive
steps: 1
simulator: {plugin: gusts}
controller: {plugin: driver}
specifications:
  in_lane: {stl: "always (offset < 1.6448536269514722)"}
thresholds: [{specification: in_lane, probability: '< 0.2'}]
estimator: {plugin: mc, rollouts: 200}
"""
CALLBACKS = """
def said(run):
    return f"{run.name} {next(iter(run.values())).probability:.2f}"


def quiet(run):
    return None


def broken(run):
    raise ValueError("no connection")
"""


@pytest.fixture
def scenario(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    info = tmp_path / "site" / "board-1.dist-info"
    info.mkdir(parents=True)
    (tmp_path / "site" / "board_callbacks.py").write_text(CALLBACKS)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: board\nVersion: 1\n")
    points = "\n".join(f"{name} = board_callbacks:{name}" for name in ("said", "quiet", "broken"))
    (info / "entry_points.txt").write_text(f"[{run_folder.GROUP}]\n{points}\n")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.syspath_prepend(str(TOY))
    default_registry.cache_clear()
    Path("drive.yaml").write_text(SCENARIO)
    yield "drive.yaml"
    default_registry.cache_clear()
    sys.modules.pop("board_callbacks", None)


def test_each_written_folder_is_given_to_them(scenario, capsys):
    assert main(["run", scenario, "--out", "a"]) == 0
    printed = capsys.readouterr().out
    probability = json.loads(Path("a/result.json").read_text())["estimates"][0]["probability"]
    assert f"drive {probability:.2f}" in printed
    assert "callback broken failed: ValueError: no connection" in printed
    assert main(["check", scenario, "--out", "b"]) == 0
    assert f"drive {probability:.2f}" in capsys.readouterr().out
    assert f"drive {probability:.2f}" in avrare.run(scenario, out="c").replies


def test_json_stays_json(scenario, capsys):
    assert main(["run", scenario, "--out", "a", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["scenario"] == "drive"
    assert "callback broken failed" in printed.err


def test_the_variable_selects_them(scenario, monkeypatch, capsys):
    monkeypatch.setenv("AVRARE_PLUGINS", "gusts,quiet")
    default_registry.cache_clear()
    main(["run", scenario, "--out", "a"])
    assert "callback" not in capsys.readouterr().out
