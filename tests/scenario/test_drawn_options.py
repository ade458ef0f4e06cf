"""Laws in the place of numbers: read, placed, and refused with line and column."""

from pathlib import Path

import pytest
import yaml

from avrare.base.errors import ScenarioError
from avrare.base.laws import Uniform
from avrare.plugin.registry import default_registry
from avrare.scenario.draws import Draws, DrawSettings
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.json_schema import scenario_schema
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode

SCENE = """\
name: drawn
steps: 3
simulator:
  plugin: single_track
  ego:
    x: 0.0
    y: 1.75
    speed: {law: normal, mean: 20.0, sd: 1.0}
  vehicles:
    - name: van
      x: {law: uniform, low: 30.0, high: 50.0}
      y: 1.75
specifications:
  clear: {stl: "always (gap > 0)"}
"""
NORMAL = "{law: normal, mean: 20.0, sd: 1.0}"


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def read(text=SCENE, *overrides):
        Path("s.yaml").write_text(text)
        return load("s.yaml", overrides)

    return read


@pytest.fixture
def refused(read):
    def refused(old, new, *overrides):
        assert old in SCENE
        with pytest.raises(ScenarioError) as caught:
            read(SCENE.replace(old, new), *overrides)
        return "\n".join(caught.value.lines())

    return refused


def test_the_plugin_sees_medians_and_the_block_has_the_laws(read):
    block = read().simulator
    assert (block.config.ego.speed, block.config.vehicles[0].x) == (20.0, 40.0)
    assert block.draws.paths == ("ego.speed", "vehicles.0.x")
    assert block.draws.names == ("ego.speed", "vehicles.van.x")
    assert [law.law for law in block.draws.laws] == ["normal", "uniform"]


def test_without_laws_there_are_no_draws(read):
    found = read(SCENE, "simulator.ego.speed=20.0", "simulator.vehicles=[]").simulator
    assert found.draws is None
    assert "draws" not in found.resolved


def test_resolved_loads_to_the_same_scenario(read, tmp_path):
    pairs = "[{between: [ego.speed, vehicles.van.x], value: 0.5}]"
    scenario = read(SCENE, f"simulator.draws.correlations={pairs}")
    Path("again.yaml").write_text(yaml.safe_dump(scenario.resolved, sort_keys=False))
    again = load("again.yaml")
    assert again.simulator.draws == scenario.simulator.draws
    assert fingerprint(again) == fingerprint(scenario)


def test_another_law_is_another_fingerprint(read):
    assert fingerprint(read()) != fingerprint(read(SCENE.replace("sd: 1.0", "sd: 1.1")))


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("normal", "norml", "8:18", "did you mean 'normal'?"),
        ("law: normal", "law: {a: 1}", "8:18", "should be one of"),
        ("sd: 1.0", "sd: -1.0", "8:42", "should be greater than 0"),
        ("sd: 1.0", "deviation: 1.0", "8:38", "unknown key"),
        ("sd: 1.0", "sd: 9.0", "8:12", "draws reach -34: should be greater than or equal to 0\n"),
        ("steps: 3", "steps: 3\nconfidence: {law: normal}", "3:13", "should be a number"),
        ("y: 1.75\n    speed", "length: {law: uniform, low: 4, high: 5}\n    y: 1.75\n    speed", "7:13",
         "these can: ego.x, ego.y, ego.speed, vehicles.0.x, vehicles.0.y"),
        ("mean: 20.0", "mean: -5.5", "8:12", "should be greater than or equal to 0, found -5.5"),
    ],
)  # fmt: skip
def test_mistakes_have_their_place(refused, old, new, place, words):
    error = refused(old, new)
    assert f"s.yaml:{place}: " in error
    assert words in error


def test_a_wrong_law_is_reported_once_and_beside_other_mistakes(refused):
    error = refused("sd: 1.0}", "sd: -1.0}\n    headng: 2.0", "simulator.vehicles.0.speed=fast")
    assert error.splitlines() == [
        "--set simulator.vehicles.0.speed: should be a number, found the string 'fast'",
        "hint: speed: at the start [m/s]",
        "s.yaml:8:42: simulator.ego.speed.sd: should be greater than 0, found -1.0",
        "hint: sd: standard deviation of the value",
        "s.yaml:9:5: simulator.ego.headng: unknown key",
        "hint: did you mean 'heading'?",
    ]


def test_a_law_for_a_number_of_another_part_is_refused(refused):
    estimator = "estimator: {plugin: mc, rollouts: {law: uniform, low: 1, high: 9}}"
    error = refused("steps: 3", f"steps: 3\n{estimator}")
    assert "s.yaml:3:35: estimator.rollouts: this option cannot be drawn: it should be a number" in error
    assert "can: " not in error


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("correlations: [{between: [ego.sped, vehicles.van.x], value: 0.5}]", "did you mean 'ego.speed'?"),
        ("correlations: [{between: [ego.speed, ego.speed], value: 0.5}]", "one and the same"),
        ("correlations: [{between: [ego.speed, vehicles.van.x], value: 1.5}]", "less than or equal to 1"),
        ("attempts: 0", "greater than or equal to 1"),
        ("overlaps: error", "did you mean 'overlap'?"),
    ],
)
def test_wrong_settings_are_refused(refused, settings, words):
    error = refused("  vehicles:", f"  draws: {{{settings}}}\n  vehicles:")
    assert "s.yaml:9:" in error
    assert words in error


def test_correlations_must_not_contradict_each_other(refused):
    pairs = {"ego.speed, vehicles.van.x": 0.9, "ego.speed, ego.x": 0.9, "ego.x, vehicles.van.x": -0.9}
    listed = ", ".join(f"{{between: [{pair}], value: {c}}}" for pair, c in pairs.items())
    drawn = "simulator.ego.x={law: normal, mean: 0, sd: 1}"
    error = refused("  vehicles:", f"  draws: {{correlations: [{listed}]}}\n  vehicles:", drawn)
    assert "contradict each other" in error


def test_settings_without_a_law_are_refused(read):
    text = SCENE.replace("  vehicles:", "  draws: {}\n  vehicles:")
    with pytest.raises(ScenarioError, match="no option of this simulator is drawn"):
        read(text, "simulator.ego.speed=20", "simulator.vehicles=[]")


def test_a_column_becomes_values_and_the_file_is_not_needed_later(read):
    Path("speeds.csv").write_text("speed,other\n18.0,1\n22.0,2\n20.0,3\n")
    text = SCENE.replace(NORMAL, "{law: empirical, file: speeds.csv, column: speed}")
    scenario = read(text)
    assert scenario.simulator.draws.laws[0].values == (18.0, 22.0, 20.0)
    assert scenario.simulator.resolved["ego"]["speed"]["values"] == [18.0, 22.0, 20.0]
    with pytest.raises(ScenarioError, match=r"has no column 'sped'"):
        read(text.replace("column: speed", "column: sped"))
    with pytest.raises(ScenarioError, match="no such file"):
        read(text.replace("speeds.csv", "sped.csv"))


@pytest.mark.parametrize(
    ("rows", "more", "words"),
    [
        ("18.0,1\n22.0\n", "", "speeds.csv:3: 1 values, but the header has 2 columns"),
        ("", "", "no rows below the header"),
        ("18.0,1\n", ", values: [1.0, 2.0]", "give values or a file, not both"),
    ],
)
def test_columns_that_cannot_be_read_are_refused(refused, rows, more, words):
    Path("speeds.csv").write_text(f"other,speed\n{rows}")
    law = f"{{law: empirical, file: speeds.csv, column: speed{more}}}"
    assert words in refused(NORMAL, law)


def test_safe_mode_reads_no_column_outside_the_folder(read):
    text = SCENE.replace(NORMAL, "{law: empirical, file: ../a.csv, column: a}")
    with safe_mode(), pytest.raises(ScenarioError, match=r"a\.csv leads out of the scenario's folder"):
        read(text)


def test_an_option_of_another_kind_named_law_is_left_alone(read):
    text = """\
name: pole
steps: 2
simulator:
  plugin: gymnasium
  env: CartPole-v1
  noise: {observation: {law: uniform, scale: 0.1}}
specifications:
  up: {stl: "always (o2 < 0.2)"}
"""
    block = read(text).simulator
    assert block.draws is None
    assert block.config.noise.observation.law == "uniform"


def test_options_may_have_dots_or_be_numbers():
    law = Uniform(law="uniform", low=0.5, high=2.0)
    places = (("parameters", "a.b"), ("parameters", "7"), ("cars", 0, "speed"))
    options = {"parameters": {"a.b": 1.0, "7": 1.0}, "cars": [{"speed": 1.0}]}
    Draws(places, ("a.b", "7", "speed"), (law,) * 3, DrawSettings()).write_into(options)
    plain = law.model_dump(mode="json")
    assert options["parameters"] == {"a.b": plain, "7": plain}
    assert options["cars"] == [{"speed": plain}]


def test_the_json_schema_allows_a_law_where_it_is_drawn():
    definitions = scenario_schema(default_registry())["$defs"]
    ego = definitions["simulator.single_track.EgoConfig"]["properties"]
    assert {"law"} == set(ego["speed"]["anyOf"][1]["required"])
    assert {"normal", "discrete"} < set(ego["speed"]["anyOf"][1]["properties"]["law"]["enum"])
    assert "anyOf" not in ego["length"]
