"""Attribution, sensitivity and requirements that are killed go on, and end with the same bytes."""

import pytest

from avrare.cli.main import main

COMMANDS = {
    "why": ["why", "night", "--specification", "near", "--fresh", "40"],
    "sensitivity": [
        "sensitivity", "walk.yaml", "--specification", "near", "--parameter", "simulator.scale",
        "--budget", "rollouts=100", "--run", "night",
    ],
    "require": [
        "require", "walk.yaml", "--specification", "near", "--parameter", "simulator.scale",
        "--probability", "< 0.3", "--between", "0.05,0.8", "--budget", "rollouts=600",
    ],
}  # fmt: skip


@pytest.fixture
def finished(inside):
    scenario = inside.scenario()
    budget = ["--set", "estimator.rollouts=100", "--set", "simulator.scale=0.2"]
    assert main(["run", scenario, *budget, "--out", "night", "--quiet", "--no-pictures"]) == 0
    text = (inside.folder / "walk.yaml").read_text()
    (inside.folder / "walk.yaml").write_text(text.replace("scale: 0.1", "scale: 0.2").replace("400", "100"))
    return inside


@pytest.mark.parametrize("command", COMMANDS)
def test_an_interrupted_command_goes_on_and_runs_nothing_twice(command, finished, stopping, capsys):
    words, folder = COMMANDS[command], finished.folder
    total = stopping([*words, "--out", "whole"])
    assert total > 10
    for chunks in (1, 4):
        assert stopping([*words, "--out", "torn", "--resume"], chunks) == chunks
        assert "resume with the same command and --resume" in capsys.readouterr().err
    assert main([*words, "--out", "torn"]) == 4
    assert "an interrupted command has left its rollouts there" in capsys.readouterr().err
    assert stopping([*words, "--out", "torn", "--resume"]) == total - 5
    name = f"{command}.json"
    assert (folder / "torn" / name).read_bytes() == (folder / "whole" / name).read_bytes()
    assert [path.name for path in (folder / "torn").iterdir()] == [name]


@pytest.mark.parametrize(
    ("command", "change", "told"),
    [
        ("why", ["--seed", "7"], "seed 0 -> 7"),
        ("why", ["--variant", "calm:simulator.scale=0.1"], "variants.calm null ->"),
        ("sensitivity", ["--step", "0.2"], "step 0.1 -> 0.2"),
        ("sensitivity", ["--set", "simulator.dt=2.0"], "scenario.simulator.dt 1.0 -> 2.0"),
        ("require", ["--seed", "7"], "seed 0 -> 7"),
        ("require", ["--set", "simulator.dt=2.0"], "scenario.simulator.dt 1.0 -> 2.0"),
    ],
)
def test_rollouts_of_another_command_are_not_taken(command, change, told, finished, stopping, capsys):
    words = [*COMMANDS[command], "--out", "torn", "--resume"]
    stopping(words, 3)
    capsys.readouterr()
    assert main([*words, *change]) == 4
    assert told in capsys.readouterr().err
    assert main(words) == 0  # it is as it was


def test_a_changed_simulator_is_noticed(finished, stopping, monkeypatch, capsys):
    words = [*COMMANDS["why"], "--out", "torn", "--resume"]
    stopping(words, 3)
    monkeypatch.setenv("AVRARE_TOY_BUG", "1")
    capsys.readouterr()
    assert main(words) == 4
    assert "does not reproduce" in capsys.readouterr().err


def test_a_refused_command_leaves_no_checkpoint(finished, capsys):
    words = ["sensitivity", "walk.yaml", "--specification", "near", "--out", "torn"]
    assert main(words) == 4
    assert "no score function" in capsys.readouterr().err
    assert not any((finished.folder / "torn").iterdir())
