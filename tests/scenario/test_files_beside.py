"""Files that a scenario names lie beside it; else their paths are from the current folder."""

from pathlib import Path

import pytest

from avrare.analysis.check.baseline_files import save
from avrare.analysis.check.targets import load_target
from avrare.analysis.failures.failure import compute_fingerprints
from avrare.base.errors import ScenarioError, UsageError
from avrare.scenario.fingerprint import digests, fingerprint
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.yaml import dump

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


def test_an_option_inside_an_option_names_a_file_beside_the_scenario(scenario, registry):
    (scenario.parent / "city.xml").write_text("<map/>")
    scenario.write_text(SCENARIO.replace("{plugin: tank}", "{plugin: box, map: {file: city.xml}}"))
    read = load(scenario, ["estimator={plugin: toy}"], registry=registry)
    assert read.simulator.config.map.file == str(scenario.parent / "city.xml")
    assert list(digests(read)) == ["simulator.map.file"]


def test_a_file_of_an_extended_scenario_lies_beside_that(scenario):
    (scenario.parent / "learned.json").write_text("{}")
    child = scenario.parent.parent / "b.yaml"
    child.write_text("name: child\nextends: scenes/a.yaml\n")
    assert learned(child) == str(scenario.parent / "learned.json")


def test_a_scenario_is_the_same_from_wherever_it_is_called(scenario, monkeypatch):
    (scenario.parent / "learned.json").write_text("{}")
    there = fingerprint(load(scenario))
    assert fingerprint(load("../scenes/a.yaml")) == there
    monkeypatch.chdir(scenario.parent)
    assert fingerprint(load("a.yaml")) == there
    assert fingerprint(load("a.yaml", ["estimator.learned=../scenes/learned.json"])) == there
    (scenario.parent / "learned.json").write_text("{ }")
    assert fingerprint(load("a.yaml")) != there


def test_failures_and_baselines_are_of_a_scenario_from_wherever_it_is_called(scenario):
    lane_change = Path(__file__).parents[2] / "scenarios" / "lane_change_published.yaml"
    scenario.write_text(dump(load(lane_change, ["perception.model=own.npz"]).resolved))
    (scenario.parent / "own.npz").write_bytes(b"1")
    first, second = load(scenario), load("../scenes/a.yaml")
    assert first.perception.config.model != second.perception.config.model
    parts = compute_fingerprints(first, "no_collision")
    assert compute_fingerprints(second, "no_collision") == parts
    folder = Path("baselines")
    save(folder, first, [])
    assert not load_target(second, folder, True, False).notes
    (scenario.parent / "own.npz").write_bytes(b"2")
    assert compute_fingerprints(second, "no_collision") != parts
    with pytest.raises(UsageError, match=r"not comparable with .*: perception\.model: its file has changed"):
        load_target(second, folder, True, False)


def test_a_run_folder_names_files_from_the_folder_it_was_made_in(scenario, monkeypatch):
    elsewhere = scenario.parent.parent / "elsewhere"
    (elsewhere / "learned.json").write_text("{}")
    run = elsewhere / "run"
    run.mkdir()
    for name, text in (("scenario.yaml", SCENARIO), ("result.json", "{}"), ("learned.json", "{ }")):
        (run / name).write_text(text)
    assert learned(run / "scenario.yaml") == "learned.json"
    monkeypatch.chdir(scenario.parent)
    assert learned("../elsewhere/run/scenario.yaml") == str(elsewhere / "learned.json")
    (run / "result.json").unlink()
    assert learned(run / "scenario.yaml") == str(run / "learned.json")


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
