import json
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.plugin.registry import default_registry


@pytest.fixture
def fake(monkeypatch):
    """Return the folder of an installed plugin, on the path; no other plugin is let in."""
    folder = Path(__file__).parents[1] / "plugin" / "fake"
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("AVRARE_PLUGINS", "fake")
    return folder


TOY = Path(__file__).parents[1] / "analysis" / "check" / "toy"
DRIVE = """\
name: drive
steps: 1
simulator: {plugin: gusts}
controller: {plugin: driver}
specifications:
  in_lane: {stl: "always (offset < 1.6448536269514722)"}     # p = 0.05
  on_road: {stl: "always (offset < 6)"}                      # p = 1e-9
estimator: {plugin: mc, rollouts: 2000}
chunk: 1000
"""


@pytest.fixture
def drive(monkeypatch, tmp_path):
    """Return a scenario of the toy plugin in the current folder; called with lines to add."""
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.chdir(tmp_path)
    default_registry.cache_clear()

    def write(more="", name="drive"):
        Path(f"{name}.yaml").write_text(DRIVE.replace("name: drive", f"name: {name}") + more)
        return f"{name}.yaml"

    yield write
    default_registry.cache_clear()


@pytest.fixture
def check(capsys):
    """Run the command; the exit code and check.json."""

    def check(*words):
        code = main(["check", *words, "--json"])
        out = capsys.readouterr().out
        return code, json.loads(out) if out else None

    return check
