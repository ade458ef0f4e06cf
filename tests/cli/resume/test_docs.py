"""The commands of docs/running.md, on a smaller scenario."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "running.md").read_text()
NIGHT, RESUME, UNTIL_SIX = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
(PYTHON,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.slow
def test_the_commands(night):
    (night.folder / "scenarios").mkdir()
    Path(night.scenario(name="lane_change")).rename(night.folder / "scenarios" / "lane_change.yaml")
    (night.folder / "runs" / "night").mkdir(parents=True)
    environment = {**night.environment, "AVRARE_TOY_PAUSE": "0.004"}

    def run(command, **changes):
        words = shlex.split(command)
        at = words.index("avrare")
        words[at : at + 1] = [sys.executable, "-m", "avrare"]
        return subprocess.run(
            words, cwd=night.folder, env={**environment, **changes}, capture_output=True, text=True,
            check=False, timeout=100,
        )  # fmt: skip

    stopped = run(UNTIL_SIX.replace("8h", "7s"), AVRARE_TOY_PAUSE="0.02")
    assert "resume with avrare run --out runs/night --resume" in stopped.stderr
    again = run(NIGHT)
    assert again.returncode == 4
    assert "contains an interrupted run" in again.stderr
    assert run(RESUME).returncode == 0
    finished = run(UNTIL_SIX)
    assert (finished.returncode, finished.stderr) == (0, "runs/night: this run is already finished\n")
    assert run(NIGHT.replace("runs/night", "whole")).returncode == 0
    assert night.result("whole") == night.result("runs/night")


@pytest.mark.slow
def test_the_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(PYTHON, names)
    assert 0.0 < names["result"].probability < 0.1
    assert list(tmp_path.iterdir()) == []
