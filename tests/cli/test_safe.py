"""``--safe``: every command that builds a scenario has it, and refuses before anything is built."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from avrare.analysis.failures.failure import Failure
from avrare.analysis.failures.storage import encode
from avrare.cli.main import command_parser, main
from avrare.cli.options import OPTIONS

HOSTILE = """\
name: toy
steps: 3
simulator:
  plugin: gymnasium
  env: CartPole-v1
  options: {render_mode: /etc/passwd}
controller: {plugin: gym_constant, action: 0}
specifications:
  near: {stl: "always (o0 > -2)"}
"""
SAID = "safe mode: '/etc/passwd' is a file outside the scenario's folder"
HONEST = HOSTILE.replace("/etc/passwd", "rgb_array")
CATALOGUE = """\
name: seas
scenes:
  - {name: calm, scenario: s.yaml, exposure: {count: 3, hours: 10.0}}
pilot: 30
budget: {rollouts: 100}
"""
COMMANDS = {
    "run": "run s.yaml --out out",
    "check": "check s.yaml",
    "compare": "compare s.yaml --estimators mc --budget steps=10",
    "compare against": "compare honest.yaml --against s.yaml",
    "validate": "validate s.yaml --build",
    "replay": "replay s.yaml --blob @blob",
    "replay run": "replay --run run",
    "falsify": "falsify s.yaml",
    "failures add": "failures add run",
    "monitor": "monitor drive.csv --scenario s.yaml --specification near",
    "monitor run": "monitor run",
    "synthesise": "synthesise s.yaml --parameter feedforward",
    "resume": "run --out interrupted --resume",
    "why": "why run",
    "sensitivity": "sensitivity s.yaml --parameter simulator.dt",
    "sensitivity of a run": "sensitivity honest.yaml --parameter simulator.dt --run run",
    "require": "require s.yaml --parameter simulator.dt --probability <0.1 --out o",
    "rate": "rate catalogue.yaml --out o",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with a stranger's scenario and run folder."""
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(HOSTILE)
    Path("honest.yaml").write_text(HONEST)
    Path("catalogue.yaml").write_text(CATALOGUE)
    Path("drive.csv").write_text("time,o0\n0,0\n1,0\n")
    estimate = {
        "specification": "near", "estimator": "mc", "probability": 0.5, "interval": [0.1, 0.9],
        "confidence": 0.95, "relative_error": 0.1, "rollouts": 10, "simulated_steps": 30, "failures": 1,
        "errors": 0, "seconds": 1.0, "health": [], "notes": [], "verdict": None,
    }  # fmt: skip
    result = {"schema": 1, "scenario": "toy", "fingerprint": "0", "seed": 0, "versions": {}}
    arrays = np.zeros((4, 4)), np.zeros(0, np.uint32), (), np.zeros((0, 0), np.float32)
    Path("blob").write_text(encode(Failure("toy", "near", {}, {}, -1.0, *arrays)))
    Path("run").mkdir()
    Path("run/scenario.yaml").write_text(HOSTILE)
    Path("run/result.json").write_text(json.dumps({**result, "estimates": [estimate]}))
    size = {"near.robustness": np.zeros(1), "near.count": np.array(1), "near.noise": np.zeros((1, 4, 4))}
    np.savez("run/failures.npz", **size)
    Path("interrupted/checkpoint/toy").mkdir(parents=True)
    Path("interrupted/checkpoint/toy/scenario.yaml").write_text(HOSTILE)
    index = {"schema": 1, "task": {"scenarios": {"toy": {}}, "budget": None}, "about": {"paths": {}}}
    Path("interrupted/checkpoint/checkpoint.json").write_text(json.dumps(index))
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_every_command_refuses(folder, capsys, command):
    assert main([*command.split(), "--safe"]) == 4
    err = capsys.readouterr().err
    assert SAID in err
    assert "hint: outside safe mode this is allowed" in err


def test_a_catalogue_names_no_scenario_elsewhere_and_changes_none(folder, capsys):
    outside = CATALOGUE.replace("s.yaml", "../honest.yaml")
    changed = CATALOGUE.replace("s.yaml,", "honest.yaml, set: ['simulator.env=Evil-v0'],")
    for text, said in ((outside, "leads out of"), (changed, "safe mode: scene 'calm' overrides options")):
        Path("catalogue.yaml").write_text(text)
        assert main(["rate", "catalogue.yaml", "--safe", "--out", "o"]) == 4
        assert said in capsys.readouterr().err
    assert not Path("o").exists()


@pytest.mark.parametrize("name", ["pilot", "pilot/calm"])
def test_no_rate_is_resumed_through_a_link(folder, capsys, name):
    mine = folder / "mine"
    mine.mkdir()
    (mine / "scenario.yaml").write_text("precious")
    (folder / "s.yaml").write_text(HONEST)
    link = folder / "theirs" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(mine)
    assert main(["rate", "catalogue.yaml", "--out", "theirs", "--resume"]) == 4
    assert "is a link" in capsys.readouterr().err
    assert [path.name for path in mine.iterdir()] == ["scenario.yaml"]


def test_no_search_goes_on_through_a_link(folder, capsys):
    (folder / "precious").mkdir()
    (folder / "precious" / "000000-000000.npz").write_text("mine")
    (folder / "theirs").mkdir()
    (folder / "theirs" / "require-checkpoint").symlink_to(folder / "precious")
    words = ["require", "honest.yaml", "--parameter", "simulator.dt", "--probability", "<0.1"]
    assert main([*words, "--out", "theirs"]) == 4
    assert "theirs/require-checkpoint: is a link" in capsys.readouterr().err
    assert (folder / "precious" / "000000-000000.npz").read_text() == "mine"


def test_the_report_of_a_run_is_written_without_its_scenario(folder, capsys):
    assert main(["report", "run", "--safe"]) == 0
    page = Path("run/report.html").read_text()
    assert "cannot be built here" in page
    assert "safe mode: &#39;/etc/passwd&#39; is a file outside" in page


def test_the_variable_stands_for_the_option(folder, capsys, monkeypatch):
    monkeypatch.setenv("AVRARE_SAFE", "1")
    assert main(["validate", "s.yaml"]) == 4
    assert SAID in capsys.readouterr().err


def test_every_command_with_a_scenario_has_it():
    """Find ``--safe`` in every command that takes a scenario or a run folder, new ones too."""
    exempt = {"failures list", "failures blob", "rules", "plugins", "new"}
    for name, options in OPTIONS.items():
        if options and name not in exempt:
            assert "--safe" in options, name
    assert "--safe" in command_parser("synthesise").format_help()


def test_baselines_stay_in_the_folder(folder, capsys):
    inner = folder / "inner"
    inner.mkdir()
    (inner / "s.yaml").write_text(HONEST + 'thresholds: [{specification: near, probability: "< 0.5"}]\n')
    (inner / "baselines").symlink_to(folder)
    assert main(["check", "inner/s.yaml", "--safe", "--save", "--budget", "rollouts=50"]) == 4
    assert "folder inner/baselines/toy leads out of the scenario's folder" in capsys.readouterr().err
    assert not (folder / "toy").exists()


@pytest.mark.parametrize("name", ["checkpoint", "checkpoint/toy", "toy"])
def test_no_run_is_resumed_through_a_link(folder, capsys, name):
    """Refuse: or else a stranger's run folder would have files elsewhere overwritten, or removed."""
    mine = folder / "mine"
    mine.mkdir()
    (mine / "scenario.yaml").write_text("precious")
    shutil.rmtree(folder / "interrupted" / name, ignore_errors=True)
    (folder / "interrupted" / name).symlink_to(mine)
    assert main(["run", "--out", "interrupted", "--resume"]) == 4
    assert f"interrupted/{name}: is a link" in capsys.readouterr().err
    assert [path.name for path in mine.iterdir()] == ["scenario.yaml"]
