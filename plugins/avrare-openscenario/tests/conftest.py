"""Simulator of an OpenSCENARIO file given as text."""

import shutil

import pytest

from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.simulator import OpenScenario
from openscenario_files import SCENARIOS


@pytest.fixture
def build(tmp_path):
    def build(text, **options):
        shutil.copy(SCENARIOS / "openscenario" / "motorway.xodr", tmp_path)
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return OpenScenario(OpenScenarioConfig(file=tmp_path / "scene.xosc", **options))

    return build
