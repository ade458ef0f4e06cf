"""``avrare validate`` with the real plugins."""

import time
from pathlib import Path

import pytest

from avrare.cli.main import main

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
PARKED = "simulator.vehicles=[{name: parked, x: 40.0, y: 1.75}]"


def test_the_scenarios_raise_no_doubts(capsys):
    for path in sorted(Path(LANE_CHANGE).parent.glob("*.yaml")):
        assert main(["validate", str(path)]) == 0
        assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("steps", "doubts"), [(39, 0), (20, 1)])
def test_build_checks_how_far_a_plugins_rule_looks(capsys, steps, doubts):
    words = ["validate", "--build", LANE_CHANGE, "--set", f"steps={steps}", "--set", PARKED]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert "built and run for 3 steps" in out
    assert err.count("warning: ") == doubts
    if doubts:
        place = f"{LANE_CHANGE}: specifications.safe_distance"
        assert err.startswith(f"warning: {place}: looks 31 samples back but a run has 20 steps: ")


def test_many_formulas_are_checked_in_no_time(capsys):
    formulas = ", ".join(
        f"f{k}: {{stl: 'always[0:3s] (gap > {k} -> once[0:2s] (ego_x > {k}))'}}" for k in range(40)
    )
    began = time.process_time()
    assert main(["validate", LANE_CHANGE, "--set", f"specifications={{{formulas}}}"]) == 0
    assert time.process_time() - began < 2.0
    assert "40 specifications" in capsys.readouterr().out
