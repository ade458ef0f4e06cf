"""A run that is killed at any call that changes a file leaves nothing, or a checkpoint that resumes."""

import json
import os
import shutil
import signal
import sys
from pathlib import Path

import pytest

from avrare.cli.main import main

CHANGES = {"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.chmod", "tempfile.mkstemp", "open"}


def run(*words):
    return main(["run", *words, "--no-pictures", "--quiet"])


def killed_at(call, words, folder):
    """Run in a child that is killed at a call that changes ``folder``; False where it came to its end."""
    if (child := os.fork()) == 0:
        left = [call]

        def watch(event, arguments):
            if event not in CHANGES or str(folder) not in os.path.abspath(str(arguments[0])):
                return
            if event == "open" and not arguments[2] & (os.O_WRONLY | os.O_RDWR):
                return
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(watch)
        os._exit(run(*words))
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def result(folder):
    content = json.loads((folder / "result.json").read_text())
    for entry in content["estimates"]:
        del entry["seconds"]
    return content


@pytest.mark.slow
def test_killed_at_every_call(inside, capsys):
    scenario, folder = inside.scenario("{plugin: mc, rollouts: 20}"), Path("torn")
    assert run(scenario, "--out", "whole") == 0
    outcomes = set()
    for call in range(500):
        shutil.rmtree(folder, ignore_errors=True)
        if not killed_at(call, [scenario, "--out", "torn"], folder.absolute()):
            break
        capsys.readouterr()
        code = run("--out", "torn", "--resume") if folder.exists() else 4
        err = capsys.readouterr().err
        outcomes.add((code, "saved nothing" in err, "already finished" in err))
        if code:
            assert not folder.exists() or "contains no interrupted run" in err, (call, err)
            assert not list(folder.rglob("*.npz")), call
            assert run(scenario, "--out", "torn") == 0, (call, capsys.readouterr().err)
        assert result(folder) == result(Path("whole")), call
        left = [path for path in folder.rglob("*") if path.name.startswith(".")]
        assert not left, (call, left)
        assert not (folder / "checkpoint").exists(), call
    assert call > 40
    assert {(0, False, False), (4, True, False), (0, False, True)} <= outcomes
