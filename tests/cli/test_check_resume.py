"""``avrare check --resume``: the same verdict and numbers after an interruption as without one."""

import json
import os
import shutil
import signal
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.output.terminal.progress_line import Progress

BOUND = "thresholds: [{specification: in_lane, probability: '< %s'}]\n"


@pytest.fixture
def interrupt(monkeypatch):
    """Let a command be ended by SIGTERM with its n-th chunk; its exit code."""

    def interrupt(n, *words):
        seen = []

        def progress(self, info):
            seen.append(info)
            if len(seen) == n:
                os.kill(os.getpid(), signal.SIGTERM)

        with monkeypatch.context() as patch:
            patch.setattr(Progress, "__call__", progress)
            return main(list(words))

    return interrupt


def stored(folder):
    content = json.loads(Path(folder, "check.json").read_text())
    for row in content["rows"]:
        row.pop("seconds")
    for result in content["results"]:
        for estimate in result["estimates"]:
            estimate.pop("seconds")
        result.pop("checksum")
    return content


@pytest.mark.parametrize(("chunk", "workers"), [(1, "1"), pytest.param(4, "2", marks=pytest.mark.slow)])
def test_a_resumed_check_has_the_numbers_of_an_undisturbed_one(drive, interrupt, capfd, chunk, workers):
    # undecided at the first look, so that the interruption falls into the first look or the second
    words = ["check", drive(BOUND % "0.052"), "--looks", "--budget", "rollouts=8000"]
    whole = main([*words, "--out", "whole"])
    assert interrupt(chunk, *words, "--out", "torn", "--resume") == 2
    err = capfd.readouterr().err
    assert "interrupted before a verdict; " in err
    assert "saved\nhint: resume with the same avrare check command and --out torn --resume" in err
    assert not Path("torn/check.json").exists()
    assert list(Path("torn/checkpoint").rglob("*.npz"))
    assert main([*words, "--out", "torn", "--resume", "--workers", workers]) == whole
    assert stored("torn") == stored("whole")
    assert not Path("torn/checkpoint").exists()
    assert stored("torn")["looks"] > 1


def test_a_finished_check_begins_again(drive, capsys, monkeypatch):
    """Take the verdict on the code as it is now, and no stored one."""
    words = ["check", drive(BOUND % "0.1"), "--out", "gate", "--resume", "--plain"]
    assert main(words) == 0
    assert "gate: nothing to resume there yet: this is the beginning\n" in capsys.readouterr().err
    first = stored("gate")
    assert main(words) == 0
    assert "is finished; it begins again, as the code may have changed\n" in capsys.readouterr().err
    assert stored("gate") == first
    import avrare_gusts

    monkeypatch.setattr(avrare_gusts.Simulator, "signals", lambda self, world: {"offset": 3.0 * world.offset})
    assert main(words) == 1
    assert json.loads(Path("gate/check.json").read_text())["exit_code"] == 1


def test_another_check_is_not_resumed(drive, interrupt, capfd):
    words = ["check", drive(BOUND % "0.052"), "--looks", "--budget", "rollouts=8000"]
    assert interrupt(1, *words, "--out", "torn", "--resume") == 2
    capfd.readouterr()
    for changed, difference in (
        ([*words[:4], "rollouts=4000"], 'budget "rollouts=8000.0" -> "rollouts=4000.0"'),
        ([*words[:2], "--budget", "rollouts=8000"], "check.looks 4 -> 1"),
        ([*words, "--seed", "7"], "scenarios.drive.seed"),
    ):
        assert main([*changed, "--out", "torn", "--resume"]) == 4
        assert difference in capfd.readouterr().err
    assert main(["run", "--out", "torn", "--resume"]) == 4
    assert "belongs to another estimate: check" in capfd.readouterr().err
    assert main([*words, "--out", "torn"]) == 4
    assert "hint: resume with the same avrare check command and --out torn --resume" in capfd.readouterr().err
    assert main(["report", "torn"]) == 4
    assert "the same avrare check command" in capfd.readouterr().err


def test_a_baseline_that_appeared_meanwhile_is_not_compared_with_itself(drive, interrupt, capfd):
    assert interrupt(1, "check", drive(), "--out", "torn", "--resume") == 2
    assert main(["check", "drive.yaml", "--quiet"]) == 0  # saves a baseline
    capfd.readouterr()
    assert main(["check", "drive.yaml", "--out", "torn", "--resume"]) == 4
    assert 'check.baselines.drive null -> "0001.json"' in capfd.readouterr().err
    shutil.rmtree("baselines")
    assert main(["check", "drive.yaml", "--out", "torn", "--resume", "--quiet"]) == 0


def test_resume_excludes_what_it_cannot_do(drive, capsys):
    scenario = drive(BOUND % "0.1")
    assert main(["check", scenario, "--resume"]) == 4
    assert "--resume requires --out" in capsys.readouterr().err
    assert main(["check", scenario, "--out", "a", "--resume", "--plan"]) == 4
    assert "--plan" in capsys.readouterr().err
    assert not Path("a").exists()
