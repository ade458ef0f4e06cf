"""``avrare validate`` with the real plugins."""

import sys
from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
PARKED = "simulator.vehicles=[{name: parked, x: 140.0, y: 1.75}]"


def test_the_scenarios_validate_without_warnings(capsys):
    for path in sorted(Path(LANE_CHANGE).parent.glob("*.yaml")):
        assert main(["validate", str(path)]) == 0
        assert capsys.readouterr().err == ""


RULE = (
    "specifications={enter: {plugin: traffic_rules, rule: R_I5}, safe: {plugin: traffic_rules, rule: R_G1}}"
)


@pytest.mark.parametrize(("steps", "doubts"), [(50, 0), (20, 1)])
def test_build_checks_the_horizon_of_a_plugins_rule(capsys, steps, doubts):
    words = ["validate", "--build", LANE_CHANGE, "--set", f"steps={steps}", "--set", PARKED, "--set", RULE]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert "built and run for 3 steps" in out
    assert err.count("warning: ") == doubts
    if doubts:
        place = f"{LANE_CHANGE}: specifications.enter"
        assert err.startswith(
            f"warning: {place}: the formula looks 50 samples ahead but a rollout ends after 20: "
        )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("build", [[], ["--build"]])
def test_a_doubtful_formula_of_a_plugin_gives_one_warning(capsys, build):
    text = "always distance(ego, parked) > -9 and drives_faster(ego, parked) > -99"
    part = f"specifications={{odd: {{plugin: traffic_rules, formula: '{text}'}}}}"
    assert main(["validate", *build, LANE_CHANGE, "--set", PARKED, "--set", part]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{LANE_CHANGE}: ok")
    assert err.startswith("warning: --set specifications: ")
    assert (err.count("warning: "), err.count("binds tighter"), err.count("\nhint: ")) == (1, 1, 1)


def test_predicates_of_vehicles_in_a_plain_formula_hint_at_the_plugin(capsys):
    part = "specifications={far: {stl: 'forall o in others: always (distance(o, ego) > 2)'}}"
    assert main(["validate", "--build", LANE_CHANGE, "--set", PARKED, "--set", part]) == 4
    message, hint = capsys.readouterr().err.splitlines()
    assert message == f"{LANE_CHANGE}: specifications.far: signal 'distance(others, ego)' is missing"
    assert "{plugin: traffic_rules, formula: ...}" in hint


@pytest.mark.parametrize(
    ("part", "method", "given", "told"),
    [
        ("Driver", "act", (np.nan, None), "controller: its action is NaN at sample 0"),
        ("Simulator", "signals", {"offset": np.full(1, np.nan)}, "simulator: its signals (offset) are NaN"),
    ],
)
def test_build_names_the_part_that_gives_nan(drive, monkeypatch, capsys, part, method, given, told):
    path = drive()
    assert main(["validate", "--build", path]) == 0
    monkeypatch.setattr(getattr(sys.modules["avrare_gusts"], part), method, lambda *_: given)
    assert main(["validate", "--build", path]) == 5
    message, hint = capsys.readouterr().err.splitlines()
    assert message.startswith(f"drive.yaml: {told}")
    assert message.endswith("of a noise-free rollout")
    assert hint == "hint: rollouts with NaN in a signal (offset) are errors: mend this part"
