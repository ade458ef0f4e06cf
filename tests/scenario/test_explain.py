from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field

from avrare.scenario.json_schema import scenario_schema
from avrare.scenario.validation import check
from avrare.scenario.yaml import parse


def test_all_problems_at_once_in_the_order_of_the_file(fails, good):
    text = good.replace("gap", "gapp").replace("steps: 40", 'steps: "40"').replace("near, p", "neer, p")
    lines, code = fails(text)
    assert code == 4
    assert lines == [
        "s.yaml:2:8: steps: should be a whole number, found the string '40'",
        "hint: steps: steps per rollout; 0 for a static problem",
        "s.yaml:6:3: simulator.gapp: unknown key",
        "hint: did you mean 'gap'?",
        "s.yaml:13:21: thresholds.0.specification: unknown specification 'neer'",
        "hint: did you mean 'near'?",
    ]


@pytest.mark.parametrize(
    ("setting", "message", "hint"),
    [
        ("simulator.mode=clam", "should be 'calm' or 'dense', found the string", "did you mean 'calm'?"),
        ("simulator.gap=true", "should be a number, found true", "gap: initial gap [m]"),
        ("simulator.gap=12 m", "should be a number, found the string '12 m'", "gap: initial gap [m]"),
        ("simulator.lanes=2.5", "should be a whole number, found 2.5", "lanes: number of lanes"),
        ("simulator.lanes=0", "should be greater than or equal to 1, found 0", "lanes: number of lanes"),
        ("simulator.size=big", "should be a number or a list, found the string 'big'", None),
        ("estimator.specifications=[]", "should be a list of specification names,", "remove the option"),
        ("simulator.label=3", "should be a string, found 3", None),
        ("tracker.delay=13", "13 is unlucky", "delay: steps of delay"),
        ("tracker.dealy=1", "unknown key", "did you mean 'delay'?"),
        ("estimator.specification=[near]", "unknown key", "did you mean 'specifications'?"),
        ("estimator.specifications=[3]", "estimator.specifications.0: should be the name of a", "known: far"),
        ("estimator.specifications=near", "should be a list of specification names,", "remove the option"),
        ("thresholds.1.confidence=0.9", "the list has no item '1'", "known: 0"),
        ("simulator.lanes", "should be KEY=VALUE", "for example"),
        ("simulator.gap=[", "not YAML", None),
        ("extends=a.yaml", "extends cannot be set here", "edit"),
        ("gap=3", "unknown key", "known: simulator.gap"),
        ("estimator=toy", "should be a mapping, found the string 'toy'", "write {plugin: toy}"),
    ],
)
def test_overrides_are_placed_at_their_key(fails, good, setting, message, hint):
    lines, code = fails(good, [setting])
    assert code == 4
    assert lines[0].startswith(f"--set {setting.split('=')[0]}: {message}")
    assert (lines[1].startswith(f"hint: {hint}")) if hint else len(lines) == 1


def test_an_override_wins_over_the_estimator_option_and_the_last_one_wins(read, good):
    settings = ["estimator.rollouts=3", "estimator.rollouts=1e1", "thresholds.0.confidence=0.9"]
    scenario = read(good, settings, "toy")
    assert scenario.estimator.config.rollouts == 10
    assert scenario.thresholds[0].confidence == 0.9
    assert read(good, estimator="toy").estimator.config.rollouts == 100
    assert read(good, ["controller={plugin: coast}"]).controller.config.delay == 0
    assert read(good, ["tracker=null"]).tracker is None


def test_an_override_deep_inside_a_value_shows_the_path(fails, good):
    lines, _ = fails(good, ["simulator.corners=[{x: 1, z: 2}, {y: 1}]"])
    assert lines[0] == "--set simulator.corners: simulator.corners.0.z: unknown key"
    assert lines[2] == "--set simulator.corners: simulator.corners.1.x: required, but missing"


@pytest.mark.parametrize(
    ("old", "new", "line", "code"),
    [
        ("straight", "strait", "s.yaml:7:19: tracker.plugin: unknown tracker 'strait'", 5),
        ("straight", "imm", "s.yaml:7:19: tracker.plugin: unknown tracker 'imm': provided by avrare-imm", 5),
        ("toy, r", "hollow, r", "s.yaml:11:21: estimator.plugin: estimator 'hollow' of avrare-fake 1.2", 5),
        ("delay: 2", "delay: 66", "s.yaml:7:1: tracker: the plugin's own check failed: RuntimeError", 5),
        ("plugin: straight, ", "", "s.yaml:7:1: tracker.plugin: required, but missing", 4),
        ("  far: {plugin: book, rule", "  far: {rule", "s.yaml:10:3: specifications.far: should have", 4),
        ("  far: {plugin", "  far: {stl: a, plugin", "s.yaml:10:3: specifications.far: should have", 4),
        ("name: toy", 'name: "a\\nb"', "s.yaml:1:7: name: a name may contain", 4),
        ("name: toy", 'name: toy\n"a\\nb": 1', "s.yaml:2:1: 'a\\nb': unknown key", 4),
    ],
)
def test_mistakes_name_their_place(fails, good, old, new, line, code):
    assert old in good
    lines, found = fails(good.replace(old, new))
    assert lines[0].startswith(line)
    assert found == code


def test_the_names_of_suppressed_warnings_are_checked_one_by_one(fails, read, good):
    assert read(good + "suppress: [leaps, extinct]\n").suppress == ("leaps", "extinct")
    lines, code = fails(good + "suppress:\n  - extinct\n  - leapss\n  - errors\n")
    assert code == 4
    assert lines == [
        "s.yaml:16:5: suppress.1: unknown health warning 'leapss'",
        "hint: did you mean 'leaps'?",
        "s.yaml:17:5: suppress.2: health warning 'errors' cannot be suppressed",
        "hint: raise max_error_rate instead",
    ]
    lines, _ = fails(good + "suppress: leaps\n")
    assert lines[0] == "s.yaml:14:11: suppress: should be a list, found the string 'leaps'"


def test_the_schema_lists_the_warnings_that_can_be_suppressed(registry):
    names = scenario_schema(registry)["properties"]["suppress"]["items"]["enum"]
    assert {"outliers", "not_deterministic", "stuck"} <= set(names)
    assert "errors" not in names


class _Normal(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    law: Literal["normal"]


class _Grid(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Literal["grid"]
    points: int = Field(description="points of the grid")
    bias: float = Field(description="shift of the grid")


class _Points(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Literal["points"]
    points: tuple[float, ...] = Field(description="the points themselves")
    search: _Normal | None = None


class _Method(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    start: _Grid = Field(_Grid(name="grid", points=1, bias=0.0), description="where it begins")
    kernel: Annotated[_Grid | _Points, Field(discriminator="name")] | None = None
    kernels: tuple[Annotated[_Grid | _Points, Field(discriminator="name")], ...] = ()


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("kernel: {name: grdi}", "1:16: kernel.name: should be one of grid, points, found the string 'grdi'",
         "did you mean 'grid'?"),
        ("kernel: {points: 3}", "1:1: kernel.name: required, but missing", "known: grid, points"),
        ("kernel: grid", "1:9: kernel: should be a mapping, found the string 'grid'", None),
        ("start: [3]", "1:8: start: should be a mapping, found a list",
         "start: where it begins, with the keys name, points, bias"),
        ("kernel: {name: grid, points: 3}", "1:1: kernel.bias: required, but missing",
         "bias: shift of the grid"),
        ("kernel: {name: grid, points: x, bias: 1}",
         "1:30: kernel.points: should be a whole number, found the string 'x'", "points: points of the grid"),
        ("kernel: {name: points, points: 3}", "1:32: kernel.points: should be a list, found 3",
         "points: the points themselves"),
        ("kernel: {name: points, points: [1], serach: 2}", "1:37: kernel.serach: unknown key",
         "did you mean 'search'?"),
        ("kernel: {name: points, points: [1], bais: 2}", "1:37: kernel.bais: unknown key",
         "known: name, points, search"),
        ("kernel: {name: points, points: [1], search: {law: n}}",
         "1:51: kernel.search.law: should be 'normal', found the string 'n'", None),
        ("kernels: [{name: grid, points: 3, bias: b}]",
         "1:41: kernels.0.bias: should be a number, found the string 'b'", "bias: shift of the grid"),
    ],
)  # fmt: skip
def test_a_mistake_in_one_member_of_a_union_is_explained_by_that_member(text, message, hint):
    _, mistakes = check(_Method, parse(text.encode(), "s.yaml"))
    assert [(mistake.message, mistake.hint) for mistake in mistakes] == [(f"s.yaml:{message}", hint)]
