import dataclasses
import os
from pathlib import Path

import pytest

from avrare.base.errors import ScenarioError
from avrare.scenario.cross_check import CrossCheck
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Formula
from avrare.scenario.yaml import dump


def test_a_valid_scenario_has_checked_blocks(read, good):
    scenario = read(good)
    assert (scenario.name, scenario.steps, scenario.seed, scenario.chunk) == ("toy", 40, 0, None)
    assert (scenario.simulator.config.gap, scenario.simulator.config.lanes) == (20.0, 2)
    assert scenario.simulator.component.factory == "avrare_fake_heavy:build"
    assert scenario.estimator.config.rollouts == 1000
    assert scenario.perception is None
    assert scenario.estimated == ("near", "far")
    assert [(t.limit, t.strict, t.confidence) for t in scenario.thresholds] == [(0.02, True, 0.95)]
    blocks = {"simulator", "tracker", "estimator", "specifications.near", "specifications.far"}
    assert set(scenario.blocks) == blocks
    assert scenario.versions["avrare-fake"] == "1.2"


def test_the_estimator_is_chosen_by_default(read, good):
    text = "\n".join(line for line in good.splitlines() if not line.startswith("estimator"))
    assert read(text).estimator.plugin == "auto"
    assert read(text, ["estimator.rollouts=7"]).estimator.config.rollouts == 7


def test_resolved_loads_to_the_same_scenario(read, good):
    exposure = "exposure={per_km: 0.1, interval: [0.05, 0.2]}"
    scenario = read(good, ["estimator.specifications=[far]", "simulator.label='1e-3'", exposure])
    again = read(dump(scenario.resolved))
    assert again == scenario
    assert fingerprint(again) == fingerprint(scenario)


def test_a_cheap_twin_is_for_two_fidelities_where_no_estimator_is_named(fails, good):
    text = good.replace("estimator: {plugin: toy, rollouts: 1e3}\n", "")
    lines, _ = fails(text + "cheap: {cost: 0.1, tracker: {delay: 1}}\n")
    assert any("'mfmc': provided by avrare-estimators, which is not installed" in line for line in lines)


def test_a_cheap_twin_differs_where_it_says_so(read, good):
    scenario = read(good + "cheap: {cost: 0.1, tracker: {delay: 1}, simulator: {gap: 30}}\n")
    assert scenario.cheap_cost == 0.1
    assert (scenario.tracker.config.delay, scenario.cheap.tracker.config.delay) == (2, 1)
    assert scenario.cheap.simulator.config.gap == 30.0
    assert scenario.cheap.cheap is None
    assert not scenario.cheap.thresholds
    assert set(scenario.resolved["cheap"]) == {"cost", "simulator", "tracker"}
    again = read(dump(scenario.resolved))
    assert again == scenario
    assert fingerprint(again) == fingerprint(scenario) != fingerprint(read(good))
    without = read(good + "cheap: {tracker: null}\n")
    assert without.cheap.tracker is None
    assert without.tracker is not None
    assert read(dump(without.resolved)) == without


def test_mistakes_in_a_cheap_twin_have_their_place(fails, good):
    lines, _ = fails(good + "cheap:\n  cost: 2\n  controler: {}\n")
    assert any("s.yaml:15:9: cheap.cost: should be less than 1" in line for line in lines)
    assert any("s.yaml:16:3: cheap.controler: unknown key" in line for line in lines)
    lines, _ = fails(good + "cheap:\n  tracker: {dellay: 1}\n")
    assert any(line.startswith("s.yaml:15:13: tracker.dellay: unknown key") for line in lines)


def test_an_ensemble_has_a_scenario_for_each_draw(read, fails, good):
    scenario = read(good + "ensemble: {tracker.delay: [1, 2, 3], simulator.gap: [19, 20, 21.5]}\n")
    assert [one.tracker.config.delay for one in scenario.members] == [1, 2, 3]
    assert [one.simulator.config.gap for one in scenario.members] == [19.0, 20.0, 21.5]
    assert all(not one.members and not one.thresholds for one in scenario.members)
    assert read(dump(scenario.resolved)) == scenario
    lines, _ = fails(good + "ensemble: {tracker.delay: [1, 2]}\n")
    assert any("s.yaml:14:1: ensemble: its lists differ in length or are short" in line for line in lines)
    lines, _ = fails(good + "ensemble: {tracker.dellay: [1, 2, 3]}\n")
    assert any("s.yaml:14:12: tracker.dellay: unknown key" in line for line in lines)
    lines, _ = fails(good + "ensemble:\n  tracker.delay: [1, 2, abc]\n")
    assert any(line.startswith("s.yaml:15:25: tracker.delay: should be") for line in lines)


@pytest.mark.parametrize("path", ["seed", "estimator.rollouts", "thresholds.0", "tracker", "tracker..delay"])
def test_a_draw_changes_the_stack_alone(fails, good, path):
    lines, _ = fails(good + f"ensemble:\n  {path}: [1, 2, 3]\n")
    assert lines[0].startswith(f"s.yaml:15:3: ensemble.{path}: is not a path in the stack")


def test_the_fingerprint_covers_everything_but_seed_and_exposure(read, good):
    first = fingerprint(read(good))
    assert len(first) == 16
    assert fingerprint(read(good, ["seed=9"])) == first
    assert fingerprint(read(good, ["exposure={count: 3, hours: 10.0}"])) == first
    assert fingerprint(read(good.replace("gap: 20", "gap: 20.0\n  lanes: 2"))) == first
    changes = ["steps=41", "simulator.gap=21", "name=other", "chunk=5", "thresholds.0.probability=0.1"]
    assert len({fingerprint(read(good, [change])) for change in changes} | {first}) == 6


def test_the_fingerprint_covers_the_versions_of_plugins(read, good, monkeypatch):
    scenario = read(good)
    newer = {name: dataclasses.replace(part, version="1.3") for name, part in scenario.specifications.items()}
    updated = dataclasses.replace(scenario, specifications=newer)
    assert updated.versions["avrare-fake"] == "1.3"
    assert fingerprint(updated) != fingerprint(scenario)


@pytest.mark.parametrize(
    ("value", "limit", "strict"),
    [('"< 2e-2"', 0.02, True), ('"<= .5"', 0.5, False), ('"1e-3"', 1e-3, True), ("0", 0.0, True)],
)
def test_thresholds_are_upper_bounds(read, good, value, limit, strict):
    [threshold] = read(good.replace('"< 2e-2"', value)).thresholds
    assert (threshold.limit, threshold.strict) == (limit, strict)


@pytest.mark.parametrize("value", ['"> 0.1"', '"< 2"', "1.5", "-1", "true", "null", "soon", ".nan", "[1]"])
def test_other_thresholds_are_refused(fails, good, value):
    lines, code = fails(good.replace('"< 2e-2"', value))
    assert lines[0].startswith("s.yaml:13:40: thresholds.0.probability: ")
    assert code == 4


def test_formulas(read, fails, good):
    text = good.replace("{plugin: book, rule: R_G2}", '{stl: "always[0:0.3s] (gap > 2)", until: half-open}')
    assert read(text).specifications["far"] == Formula(stl="always[0:0.3s] (gap > 2)", until="half-open")
    for wrong in ["always (gap > )", "always[0:0.25s] (gap > 2)", "gap >", ""]:
        lines, code = fails(text.replace("always[0:0.3s] (gap > 2)", wrong))
        assert lines[0].startswith("s.yaml:10:14: specifications.far.stl: ")
        assert code == 4
    lines, _ = fails(text.replace("half-open", "open"))
    assert lines[0].startswith("s.yaml:10:")
    assert "'closed' or 'half-open'" in lines[0]


# --- extends ---------------------------------------------------------------------------------------


def write(folder, **files):
    for name, text in files.items():
        Path(folder, f"{name}.yaml").write_text(text)


BASE = """\
steps: 40
simulator: {plugin: box, gap: 20, lanes: 3, corners: [{x: 1}, {x: 2}]}
tracker: {plugin: straight, delay: 2}
controller: {plugin: coast, delay: 4}
specifications:
  near: {plugin: book, rule: R_G1}
  far: {stl: "always (gap > 0)"}
estimator: {plugin: toy, rollouts: 5, level: 0.5}
"""


def test_extends_merges_deeply(tmp_path, monkeypatch, registry):
    monkeypatch.chdir(tmp_path)
    os.mkdir("_base")
    write("_base", road=BASE)
    child = (
        "name: child\nextends: _base/road.yaml\nsimulator: {gap: 7, corners: [{x: 9}]}\n"
        "controller: null\nestimator: {plugin: mc}\nspecifications:\n  far: {plugin: book, rule: R_G2}\n"
        "tracker: {delay: null}\n"
    )
    write(".", child=child)
    scenario = load("child.yaml", registry=registry)
    assert (scenario.simulator.config.gap, scenario.simulator.config.lanes) == (7.0, 3)
    assert [corner.x for corner in scenario.simulator.config.corners] == [9.0]
    assert scenario.controller is None
    assert scenario.tracker.config.delay == 0
    assert scenario.estimator.plugin == "mc"
    assert scenario.specifications["far"].plugin == "book"
    assert "extends" not in scenario.resolved


def refused(path, registry):
    with pytest.raises(ScenarioError) as caught:
        load(path, registry=registry)
    return caught.value.lines()


def test_a_mistake_in_the_base_is_placed_in_the_base(tmp_path, monkeypatch, registry):
    monkeypatch.chdir(tmp_path)
    write(".", base=BASE.replace("gap: 20", "gapp: 20"), mid="extends: base.yaml\nseed: -1\n")
    write(".", child="name: child\nextends: mid.yaml\nsteps: x\n")
    assert [line for line in refused("child.yaml", registry) if "hint" not in line] == [
        "base.yaml:2:26: simulator.gapp: unknown key",
        "child.yaml:3:8: steps: should be a whole number, found the string 'x'",
        "mid.yaml:2:7: seed: should be greater than or equal to 0, found -1",
    ]


def test_circular_missing_and_remote_bases_are_refused(tmp_path, monkeypatch, registry):
    monkeypatch.chdir(tmp_path)
    write(".", a="extends: b.yaml\n", b="extends: ./a.yaml\n", own="x: 1\nextends: own.yaml\n")
    assert "circle: a.yaml -> b.yaml -> a.yaml" in refused("a.yaml", registry)[0]
    assert refused("own.yaml", registry)[0].startswith("own.yaml:2:10: extends: files extend")
    for target, words in [
        ("c.yaml", "c.yaml: no such file"),
        ("/etc/passwd", "not a local relative path"),
        ("https://example.org/a.yaml", "not a local relative path"),
        ("~/a.yaml", "not a local relative path"),
        ("[a.yaml]", "should be the path"),
        ('"a\\tb"', "no such file"),
        (".", "cannot be read"),
    ]:
        write(".", s=f"name: s\nextends: {target}\n")
        line = refused("s.yaml", registry)[0]
        assert line.startswith("s.yaml:2:10: extends: ")
        assert words in line


def test_setting_another_plugin_drops_the_options_of_the_old_one(read, good):
    assert read(good, ["estimator.plugin=mc"]).estimator.config.rollouts == 1000
    assert read(good, ["tracker.plugin=straight"]).tracker.config.delay == 2


def test_a_cross_check_is_an_option_of_its_own(read, good):
    assert read(good).cross_check is None
    assert "cross_check" not in read(good).resolved  # fingerprints of before stay what they were
    assert read(good + "cross_check: false\n") == read(good)
    plain = read(good + "cross_check: true\n")
    assert plain.cross_check == CrossCheck(estimator=None, share=0.15)
    chosen = read(good + "cross_check: {estimator: ess, share: 0.3}\n")
    assert chosen.cross_check == CrossCheck(estimator="ess", share=0.3)
    assert len({fingerprint(one) for one in (read(good), plain, chosen)}) == 3
    assert read(dump(chosen.resolved)) == chosen


def test_the_switch_of_the_cross_check_keeps_the_options_of_the_file(read, good):
    text = good + "cross_check: {estimator: ess, share: 0.3}\n"
    assert read(text, ["cross_check=true"]) == read(text)
    assert read(good, ["cross_check=true"]).cross_check == CrossCheck()
    assert read(good + "cross_check: false\n", ["cross_check=true"]).cross_check == CrossCheck()
    assert read(text, ["cross_check=false"]).cross_check is None
    assert read(text, ["cross_check={share: 0.5}"]).cross_check == CrossCheck(share=0.5)
