"""Files that a scenario names lie beside it; else their paths are from the current folder."""

import pytest

from avrare.base.errors import ScenarioError
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode

SCENARIO = """\
name: lonely
steps: 3
simulator: {plugin: tank}
specifications: {dry: {stl: "always (level < 2)"}}
estimator: {plugin: is, learned: learned.json}
"""


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    folder, elsewhere = tmp_path / "scenes", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    (folder / "a.yaml").write_text(SCENARIO)
    return folder / "a.yaml"


def learned(path, *settings):
    return load(path, settings).estimator.config.learned


def test_a_file_beside_the_scenario_comes_first(scenario):
    (scenario.parent / "learned.json").write_text("{}")
    (scenario.parent.parent / "elsewhere" / "learned.json").write_text("{}")
    assert learned(scenario) == str(scenario.parent / "learned.json")


def test_else_a_path_is_from_the_current_folder(scenario):
    assert learned(scenario) == "learned.json"
    assert learned(scenario, "estimator.learned=../scenes/a.yaml") == "../scenes/a.yaml"


def test_a_path_of_the_command_line_is_from_the_current_folder(scenario):
    (scenario.parent / "learned.json").write_text("{}")
    assert learned(scenario, "estimator.learned=learned.json") == "learned.json"


def test_a_file_of_an_extended_scenario_lies_beside_that(scenario):
    (scenario.parent / "learned.json").write_text("{}")
    child = scenario.parent.parent / "b.yaml"
    child.write_text("name: child\nextends: scenes/a.yaml\n")
    assert learned(child) == str(scenario.parent / "learned.json")


def test_safe_mode_follows_no_link_beside_the_scenario(scenario):
    secret = scenario.parent.parent / "secret.json"
    secret.write_text("{}")
    (scenario.parent / "learned.json").symlink_to(secret)
    with safe_mode(), pytest.raises(ScenarioError, match="outside the scenario's folder"):
        load(scenario)
    (scenario.parent / "learned.json").unlink()
    (scenario.parent / "learned.json").write_text("{}")
    with safe_mode():
        assert learned(scenario) == str(scenario.parent / "learned.json")
