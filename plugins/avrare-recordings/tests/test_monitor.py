"""``avrare monitor`` as a user meets it."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main
from avrare.results.stored_results import read_failures

ROOT = Path(__file__).parents[3]
LANE_CHANGE = str(ROOT / "scenarios" / "lane_change_published.yaml")
DRIVE = str(ROOT / "docs" / "cut_in.csv")
LANES = ["--lanes", "-1.75,1.75,5.25"]
COMMONROAD = ROOT.parent / "shared" / "data" / "commonroad" / "Complex.xml"


@pytest.fixture
def monitor(tmp_path, monkeypatch, capsys):
    """Run the command in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def monitor(*words):
        code = main(["monitor", *map(str, words)])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return monitor


@pytest.fixture
def gaps(tmp_path):
    rows = "".join(f"{0.5 * k},{gap}\n" for k, gap in enumerate([5, 4, 3, 2, 1, 0.5, 3]))
    (tmp_path / "gaps.csv").write_text("time,gap\n" + rows)
    return "gaps.csv"


def test_a_signal_that_breaks_a_formula(gaps, monitor):
    code, out, err = monitor(gaps, "--stl", "always (gap > 2)")
    assert (code, err) == (1, "")
    assert "7 samples, 0.5 s apart, 0.0 to 3.0 s" in out
    verdict = "formula violated first at 1.5 s: gap > 2 has robustness 0 (worst robustness -1.5 at 2.5 s)"
    assert verdict in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 80


def test_a_formula_that_is_undecided_at_first(gaps, monitor):
    code, out, _ = monitor(gaps, "--stl", "eventually[1:2s] (gap < 1.5)", "--json")
    found = json.loads(out)
    assert (code, found["verdict"], found["robustness"], found["body"]) == (0, "kept", 0.5, None)
    assert found["violated"] == [True, True, True, True, False, False, False]
    assert found["prefix"] == [None, None, -1.5, -0.5, 0.5, 0.5, 0.5]


def test_json_contains_the_complete_series(gaps, monitor):
    code, out, err = monitor(gaps, "--stl", "always (gap > 2)", "--json")
    found = json.loads(out)
    assert (code, err) == (1, "")
    assert found["body"] == [3, 2, 1, 0, -1, -1.5, 1]
    assert found["prefix"] == [3, 2, 1, 0, -1, -1.5, -1.5]
    assert found["violated"] == [False] * 3 + [True] * 4
    assert (found["first"]["sample"], found["first"]["time"], found["first"]["value"]) == (3, 1.5, 0)
    assert (found["worst"]["sample"], found["worst"]["formula"]) == (5, "gap > 2")


def test_a_rule_names_time_vehicle_and_reason(monitor):
    code, out, _ = monitor(DRIVE, "--rule", "R_G1", *LANES)
    assert code == 1
    assert "the ego and van, truck" in out
    assert re.search(r"R_G1 violated first at 4\.\d s with van: keeps_safe_distance\(ego, van\)", out)


def test_a_formula_over_vehicles(monitor):
    formula = "forall o in others: always (time_to_collision(ego, o) > 3)"
    code, out, err = monitor(DRIVE, "--stl", formula, *LANES)
    assert (code, err) == (1, "")
    assert "with van: time_to_collision(ego, van) > 3 has robustness" in " ".join(out.split())
    code, out, err = monitor(DRIVE, "--stl", "forall o in others: always (distance > 4)")
    assert (code, err) == (1, "")
    assert "violated first and worst at 0.0 s with truck" in out
    code, _, err = monitor(DRIVE, "--stl", formula.replace("collision", "colision"), *LANES)
    assert code == 4
    assert "did you mean 'time_to_collision'?" in err


def test_a_doubtful_formula_is_scored_with_a_warning(gaps, monitor):
    code, out, err = monitor(gaps, "--stl", "always gap > 2 and gap > 0")
    assert code == 1
    assert err.startswith("warning: line 1, column 1: ")
    assert "formula violated" in out


def test_a_long_formula_is_shown_without_its_definitions(monitor):
    _, out, _ = monitor(DRIVE, "--rule", "R_I2", *LANES)
    assert "(--json prints its definitions)\n  forall o in others: always" in out
    assert "in_congestion(a) =" not in out
    _, out, _ = monitor(DRIVE, "--rule", "R_I2", *LANES, "--json")
    assert "in_congestion(a) =" in json.loads(out)["formula"]


def test_a_rule_without_any_vehicle_it_applies_to(monitor, tmp_path):
    alone, parked = [], []
    for line in Path(DRIVE).read_text().splitlines():
        time, name, *_ = line.split(",")
        if name in ("vehicle", "ego"):
            alone.append(line)
            parked += [line, *([f"{time},parked,90,1.75,0,0,4,2"] if name == "ego" else [])]
    (tmp_path / "alone.csv").write_text("\n".join(alone))
    (tmp_path / "parked.csv").write_text("\n".join(parked))
    for name, excluded in (("alone", ""), ("parked", " (excluded: parked)")):
        code, out, _ = monitor(f"{name}.csv", "--rule", "R_G1", *LANES)
        assert code == 0
        assert f"R_G1 satisfied: there are no vehicles that it applies to{excluded}\n" in out
        assert "robustness at" not in out


def test_a_rules_options_can_be_set(monitor):
    code, out, _ = monitor(DRIVE, "--rule", "R_G1", *LANES, "--set", "cut_in_time=0.5", "--json")
    early = json.loads(out)["first"]["time"]
    assert code == 1
    assert early < 4.0
    wrong = ["--set", "cut_in_tim=1", "--set", "reaction_time=x"]
    code, _, err = monitor(DRIVE, "--rule", "R_G1", *LANES, *wrong)
    assert code == 4
    assert err.startswith("--set cut_in_tim: unknown key\nhint: did you mean 'cut_in_time'?\n")
    assert "--set reaction_time: should be a number, found the string 'x'" in err


@pytest.mark.slow
def test_the_road_of_a_scenario(monitor):
    one = monitor(DRIVE, "--rule", "R_G1", "--json", "--scenario", LANE_CHANGE)
    other = monitor(DRIVE, "--rule", "R_G1", "--json", *LANES, "--access-ramp", "0")
    assert one == other
    named = monitor(DRIVE, "--specification", "safe_distance", "--json", "--scenario", LANE_CHANGE)
    assert json.loads(named[1])["prefix"] == json.loads(one[1])["prefix"]
    assert json.loads(named[1])["specification"] == "safe_distance"


def test_an_absent_vehicle_violates_no_rule(monitor, tmp_path):
    lines = Path(DRIVE).read_text().splitlines(keepends=True)
    (tmp_path / "alone.csv").write_text("".join(line for line in lines if ",truck," not in line))
    for rule in ("R_G1", "R_G2", "R_G4", "R_I2"):
        both = [monitor(path, "--rule", rule, *LANES, "--json") for path in (DRIVE, "alone.csv")]
        late = [json.loads(out)["body"][41:] for _, out, _ in both]  # the truck is gone
        if rule != "R_G4":
            assert np.sign(late[0]).tolist() == np.sign(late[1]).tolist()
        assert all(value is None or np.isfinite(value) for value in late[0])


def test_files_of_the_result(gaps, monitor, tmp_path):
    code, out, _ = monitor(gaps, "--stl", "always (gap > 2)", "--out", "result/deep")
    assert code == 1
    assert out.endswith("written to result/deep\n")
    folder = tmp_path / "result" / "deep"
    assert sorted(path.name for path in folder.iterdir()) == ["monitor.csv", "monitor.json", "monitor.png"]
    assert len((folder / "monitor.csv").read_text().splitlines()) == 8
    assert json.loads((folder / "monitor.json").read_text())["verdict"] == "broken"
    assert (folder / "monitor.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "file").write_text("")
    code, _, err = monitor(gaps, "--stl", "always (gap > 2)", "--out", "file/deep")
    assert code == 4
    assert err.startswith("file/deep: cannot write: ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gaps.csv"], "no specification given"),
        (["gaps.csv", "--stl", "a", "--rule", "R_G1"], "--rule and --stl cannot be combined"),
        (["gaps.csv", "--stl", "gap > )"], "line 1, column 7"),
        (["gaps.csv", "--stl", "always (gp > 2)"], "signal 'gp' is missing\nhint: did you mean 'gap'?"),
        (["gaps.csv", "--stl", "always[0:0.7s] (gap > 2)"], "not a whole multiple of dt = 0.5 s"),
        (["gaps.csv", "--stl", "gap > 2", "--set", "a=1"], "a formula over signals has no options"),
        (["gaps.csv", "--stl", "gap > 2", "--failure", "1"], "--failure requires a run folder"),
        (["gaps.csv", "--rule", "R_G1"], "gaps.csv: a rule needs vehicles"),
        (["gaps.csv", "--specification", "a"], "--specification requires --scenario"),
        ([DRIVE, "--rule", "R_G1"], "a rule needs a road"),
        ([DRIVE, "--rule", "r_g1", *LANES], "did you mean 'R_G1'?"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--ego", "me"], "no vehicle is called 'me'"),
        ([DRIVE, "--rule", "R_G1", "--lanes", "2,1"], "from right to left"),
        ([DRIVE, "--rule", "R_G1", "--lane-width", "3"], "require --lanes"),
        ([DRIVE, "--rule", "R_G1", "--lane-width", "0"], "require --lanes"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--lane-width", "wide"], "invalid float value"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--lane-width", "0"], "--lane-width should be above zero"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--access-ramp", ""], "--access-ramp should name lanes 0 to 2"),
        ([DRIVE, "--rule", "R_G1", "--lanes", ""], "--lanes should be numbers"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--ego", ""], "no vehicle is called ''"),
        ([DRIVE, "--rule", "R_G1", *LANES, "--out", ""], "--out is empty"),
        ([DRIVE, "--rule", "R_G1", "--scenario", ""], "'': no such file"),
        ([DRIVE, "--rule", "R_G9", *LANES], "did you mean 'R_G1', 'R_G2', 'R_G3' or 'R_G4'?"),
        ([DRIVE, "--stl", "always (distance(ego, van) > 2)"], "predicates of vehicles need a road"),
        (["gaps.csv", "--stl", "always (distance(ego, van) > 2)"], "predicates of vehicles need vehicles"),
        ([".", "--lane-width", "0"], "--lane-width cannot be used with a run folder"),
        ([DRIVE, "--specification", "safe", "--scenario", LANE_CHANGE], "unknown specification 'safe'"),
        (["none.csv", "--stl", "a > 0"], "none.csv: no such file"),
        (["none.xml", "--rule", "R_G1", "--ego", "1"], "none.xml"),
        ([".", "--ego", "a"], "--ego cannot be used with a run folder"),
        (["."], "no result.json in it"),
    ],
)
def test_wrong_arguments_are_a_clear_error(gaps, monitor, words, message):
    found, out, err = monitor(*words)
    assert (found, out) == (4, "")
    assert message in err


def test_a_commonroad_file(monitor):
    if not COMMONROAD.exists():
        pytest.skip("the sample scenario is not here")
    code, out, err = monitor(COMMONROAD, "--rule", "no_collision", "--ego", "13")
    assert code in (0, 1)
    assert err == ""
    assert "80 samples, 0.1 s apart, 0.0 to 7.9 s; the ego and 14, 15" in out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run in which one specification fails sometimes."""
    folder = tmp_path_factory.mktemp("run")
    words = [
        "run",
        LANE_CHANGE,
        "--set",
        "steps=8",
        "--set",
        "estimator.rollouts=8",
        "--no-pictures",
        "--json",
    ]
    parked = "simulator.vehicles=[{name: parked, x: 40.0, y: 1.75}]"
    formula = "specifications={near: {stl: 'always (gap > 1.98)'}}"
    assert main([*words, "--set", parked, "--set", formula, "--out", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_a_failure_of_a_run_is_replayed(folder, monitor):
    stored = read_failures(folder)["near"]
    code, out, err = monitor(folder, "--json")
    found = json.loads(out)
    assert (code, err) == (1, "")
    assert (found["specification"], found["samples"]) == ("near", 9)
    assert found["robustness"] == stored.robustness.min()
    code, out, err = monitor(folder, "--failure", 0, "--json")
    assert json.loads(out)["robustness"] == stored.robustness[0]
    code, out, err = monitor(folder, "--rule", "no_collision")
    assert (code, err) == (0, "")
    assert "no_collision satisfied with robustness" in out


def test_a_failure_that_replays_differently_is_a_warning(folder, monitor, tmp_path):
    for name in ("scenario.yaml", "result.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with np.load(folder / "failures.npz") as stored:
        arrays = dict(stored)
    arrays["near.robustness"][0] -= 5.0
    np.savez(tmp_path / "failures.npz", **arrays)
    code, _, err = monitor(tmp_path)
    assert code == 1
    assert err.startswith("warning: failure 0 of near: robustness ")
    assert err.count("\n") == 1


def test_the_page_shows_what_the_command_prints(monitor, monkeypatch):
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "monitor.md").read_text()
    blocks = re.findall(r"```console\n\$ avrare monitor (.*?)\n(.*?)```", page, re.DOTALL)
    assert blocks
    for words, shown in blocks:
        _, out, _ = monitor(*shlex.split(words))
        assert [line.rstrip() for line in out.splitlines()] == shown.splitlines()
