"""Baseline files: written, read and refused; differences between two scenarios that change the problem."""

import json
import math

import pytest

from avrare.analysis.check import baseline_files as baseline
from avrare.analysis.check.baseline_files import find_differences
from avrare.base.errors import UsageError
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal, derive_distribution
from avrare.scenario.load import load


@pytest.fixture
def scenario(drive):
    return load(drive())


def test_files_are_numbered_and_the_newest_is_read(scenario, estimate, tmp_path):
    folder = tmp_path / "deep" / "folder"
    assert baseline.read_newest(folder) is None
    first = baseline.save(folder, scenario, [estimate(Binomial(5, 1000))])
    (folder / "notes.txt").write_text("no baseline")
    (folder / "0007.json").write_bytes(first.read_bytes())
    second = baseline.save(folder, scenario, [estimate(LogNormal(1e-3, 0.1, 9), health={"ties": "..."})])
    assert (first.name, second.name) == ("0001.json", "0008.json")
    found = baseline.read_newest(folder)
    assert found.path == second
    assert list(found.entries["rule"].health) == ["ties"]
    assert derive_distribution(found.entries["rule"]) == LogNormal(1e-3, 0.1, 9)
    assert found.scenario == scenario.resolved
    assert found.versions == scenario.versions
    assert found.versions["avrare-gusts"] == "1.0"


def test_the_first_of_a_line_is_stored_with_every_later_one(scenario, estimate, tmp_path):
    old = baseline.read(baseline.save(tmp_path, scenario, [estimate(Binomial(5, 1000))]))
    assert old.firsts == {}
    new = baseline.read(baseline.save(tmp_path, scenario, [estimate(Binomial(9, 1000))], old.entries))
    assert new.firsts["rule"].to_json() == old.entries["rule"].to_json()
    laws = [derive_distribution(entries["rule"]) for entries in (new.firsts, new.entries)]
    assert laws == [Binomial(5, 1000), Binomial(9, 1000)]


@pytest.mark.parametrize("law", [Binomial(0, 10), Binomial(5, 1000), LogNormal(1e-3, 0.1, 9)], ids=str)
def test_an_estimate_survives(scenario, estimate, tmp_path, law):
    result = estimate(law, relative_error=math.nan if law == Binomial(0, 10) else 0.1)
    path = baseline.save(tmp_path, scenario, [result])
    entry = baseline.read(path).entries["rule"]
    assert (derive_distribution(entry), entry.interval) == (law, result.interval)
    assert entry.to_json() == result.to_json().replace(str(result.run_probabilities.tolist()), "[]")


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda text: text[:40], "cannot be read: "),
        (lambda text: text.replace('"schema": 1', '"schema": 2'), "has schema 2"),
        (lambda text: text.replace('"law": "binomial"', '"law": "levy"'), "not an estimate"),
        (lambda text: text.replace('"relative_error": ', '"relative_error": 1e300, "x": '), "relative_error"),
        (
            lambda text: json.dumps({**json.loads(text), "estimates": [{}]}),
            r"estimates\.0\.specification: Field",
        ),
    ],
)
def test_a_damaged_file_is_refused_with_its_name(scenario, estimate, tmp_path, break_it, message):
    path = baseline.save(tmp_path, scenario, [estimate(Binomial(5, 1000))])
    path.write_text(break_it(path.read_text()))
    with pytest.raises(UsageError, match=message) as caught:
        baseline.read_newest(tmp_path)
    assert str(path) in caught.value.message
    assert "remove it" in caught.value.hint


OLD = {
    "steps": 40, "simulator": {"plugin": "box", "dt": 0.1, "cars": [{"x": 1.0}, {"x": 2.0}]},
    "perception": {"plugin": "gp"}, "controller": {"plugin": "mpc", "horizon": 8}, "seed": 0,
    "specifications": {"near": {"stl": "always (gap > 2)", "until": "closed", "score": None}},
    "estimator": {"plugin": "mc"}, "thresholds": [],
}  # fmt: skip


def changed(**changes):
    return find_differences(OLD, {**OLD, **changes}, ["near"])


def test_the_stack_the_estimator_and_the_thresholds_may_change():
    assert changed(controller={"plugin": "other"}, tracker={"plugin": "imm"}, seed=3) == []
    assert changed(estimator={"plugin": "ams"}, thresholds=[1], chunk=5, name="x", confidence=0.9) == []


def test_the_world_the_length_the_perception_and_the_rules_may_not():
    assert changed(steps=41) == ["steps 40 -> 41"]
    assert changed(simulator={**OLD["simulator"], "dt": 0.05}) == ["simulator.dt 0.1 -> 0.05"]
    cars = [{"x": 1.0}, {"x": 3.0}]
    assert changed(simulator={**OLD["simulator"], "cars": cars}) == ["simulator.cars.1.x 2.0 -> 3.0"]
    assert changed(simulator={**OLD["simulator"], "cars": []})[0].startswith("simulator.cars [{")
    assert changed(simulator={**OLD["simulator"], "wet": True}) == ["simulator.wet none -> True"]
    assert changed(perception=None) == ["perception gp -> none"]
    assert changed(perception={"plugin": "other", "x": 1}) == ["perception.plugin gp -> other"]
    rule = {**OLD["specifications"]["near"], "stl": "always (gap > 3)"}
    assert changed(specifications={"near": rule}) == [
        "specifications.near.stl always (gap > 2) -> always (gap > 3)"
    ]


def test_a_score_and_rules_of_one_side_only_are_not_a_difference():
    rule = {**OLD["specifications"]["near"], "score": "margin"}
    assert changed(specifications={"near": rule, "new": {"stl": "x"}}) == []
    assert changed(specifications={}) == []
