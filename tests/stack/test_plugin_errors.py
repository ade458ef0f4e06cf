"""What a plugin's own code gets wrong is told as its mistake, with the place: it is no bug of avrare."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from avrare import UsageError
from avrare.base.errors import PluginError
from avrare.plugin import Component
from avrare.protocols import Simulator
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Block
from avrare.stack.builder import build_block
from avrare.stack.features import check_features

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SOURCES = {
    "syntax": ("x = = 1", "cannot be loaded: SyntaxError: invalid syntax", "odd_part.py:1"),
    "name": ("x = y", "cannot be loaded: NameError: name 'y' is not defined", "odd_part.py:1 in <module>"),
    "attribute": ("def bild(config, scene): ...", "cannot be loaded: AttributeError", "no attribute 'build'"),
    "value": (
        "def build(config, scene):\n    raise ValueError('too small')",
        "cannot be built: ValueError: too small", "odd_part.py:2 in build",
    ),
    "exit": ("def build(config, scene):\n    exit(0)", "cannot be built: SystemExit: 0", "in __call__"),
    "none": ("def build(config, scene): ...", "is not complete: NoneType has no", "noise_size"),
    "members": (
        "class Part:\n    dt = 1\n    reset = step = signals = None\ndef build(config, scene): return Part()",
        "is not complete: Part has no noise_size", "",
    ),
}  # fmt: skip


@pytest.fixture
def build(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)

    def build(source):
        (tmp_path / "odd_part.py").write_text(source)
        monkeypatch.delitem(sys.modules, "odd_part", raising=False)
        component = Component("simulator", "odd", "json:JSONDecoder", "odd_part:build", "for tests")
        return build_block(Block("odd", component, SimpleNamespace(), "avrare-odd", "1.0"), None, Simulator)

    yield build
    sys.modules.pop("odd_part", None)


@pytest.mark.parametrize("name", SOURCES)
def test_a_part_that_cannot_be_built_names_the_place(build, name):
    source, reason, place = SOURCES[name]
    with pytest.raises(PluginError) as raised:
        build(source)
    owner = "" if name in ("none", "members") else "of avrare-odd "
    assert f"simulator 'odd' {owner}{reason}" in raised.value.message
    assert place in raised.value.message
    assert "avrare plugins --check odd" in raised.value.hint


def test_a_missing_library_is_to_be_installed(build):
    with pytest.raises(PluginError, match="No module named 'no_such_library'") as raised:
        build("import no_such_library")
    assert "'no_such_library'" in raised.value.hint
    assert "pip install" in raised.value.hint


@pytest.mark.parametrize("values", [3.0, np.zeros(4), np.zeros((2, 3, 4))])
def test_features_of_another_shape_are_refused(values):
    with pytest.raises(UsageError, match=r"features of object have shape .*, not \(N, F\)"):
        check_features(object(), values)


def test_an_estimator_that_cannot_be_built_is_told_too(monkeypatch):
    def broken(config, scene):
        raise ValueError("no rollouts today")

    monkeypatch.setattr("avrare.estimation.monte_carlo.monte_carlo.build", broken)
    scenario = load(str(SCENARIOS / "double_integrator.yaml"), ("estimator={plugin: mc}",))
    with pytest.raises(PluginError, match="estimator 'mc' of avrare cannot be built: ValueError: no roll"):
        LoadedScenario(scenario).estimator()
