from importlib.metadata import distributions
from pathlib import Path

import pytest

from avrare.base.errors import ScenarioError
from avrare.plugin.registry import Registry
from avrare.scenario.load import load

GOOD = """\
name: toy
steps: 40
simulator:
  plugin: box
  dt: 0.1
  gap: 20
tracker: {plugin: straight, delay: 2}
specifications:
  near: {plugin: book, rule: R_G1}
  far: {plugin: book, rule: R_G2}
estimator: {plugin: toy, rollouts: 1e3}
thresholds:
  - {specification: near, probability: "< 2e-2"}
"""


@pytest.fixture
def good():
    """Return the text of a scenario without mistakes."""
    return GOOD


@pytest.fixture
def registry(monkeypatch):
    """Return the core's own components and those of the fake plugin, whatever else is installed."""
    folder = str(Path(__file__).parents[1] / "plugin" / "fake")
    monkeypatch.syspath_prepend(folder)
    return Registry(point for found in distributions(path=[folder]) for point in found.entry_points)


@pytest.fixture
def read(tmp_path, monkeypatch, registry):
    """Load scenario text from the file ``s.yaml`` of the current folder."""
    monkeypatch.chdir(tmp_path)

    def read(text, overrides=(), estimator=None):
        data = text if isinstance(text, bytes) else text.encode()
        Path("s.yaml").write_bytes(data)
        return load("s.yaml", overrides, estimator, registry)

    return read


@pytest.fixture
def fails(read):
    """Return the lines and the exit code of loading a scenario with mistakes."""

    def fails(text, overrides=(), estimator=None):
        with pytest.raises(ScenarioError) as caught:
            read(text, overrides, estimator)
        return caught.value.lines(), int(caught.value.exit_code)

    return fails
