"""``avrare run`` as a user meets it."""

import json
import os
import sys
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
SMALL = ["--set", "steps=6", "--set", "estimator.rollouts=4", "--no-pictures"]
RULES = ["safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision"]
FIELDS = {
    "specification", "estimator", "probability", "interval", "confidence", "relative_error", "rollouts",
    "simulated_steps", "failures", "errors", "seconds", "health", "notes", "verdict",
}  # fmt: skip


@pytest.mark.slow
def test_run_writes_the_documented_result(tmp_path, capsys):
    assert main(["run", LANE_CHANGE, *SMALL, "--out", str(tmp_path), "--seed", "7"]) == 0
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["schema"] == 1
    assert (result["scenario"], result["seed"]) == ("lane_change", 7)
    assert len(result["fingerprint"]) == 16
    assert "avrare-mpc" in result["versions"]
    assert [entry["specification"] for entry in result["estimates"]] == RULES
    for entry in result["estimates"]:
        assert set(entry) >= FIELDS
        assert entry["rollouts"] == 4
        assert entry["simulated_steps"] == 4 * 6
        low, high = entry["interval"]
        assert 0 <= low <= entry["probability"] <= high <= 1
    again = load(tmp_path / "scenario.yaml")
    assert (again.steps, again.seed) == (6, 7)
    assert fingerprint(again) == result["fingerprint"]
    provenance = json.loads((tmp_path / "provenance.json").read_text())
    assert set(provenance) == {"date", "command", "python", "commit", "uncommitted_changes", "budget"}
    table = capsys.readouterr().out
    for rule in RULES:
        assert rule in table


TANK = """\
name: {name}
steps: 4
simulator: {{plugin: tank}}
specifications:
  low: {{stl: "always (level < 1.9)"}}
estimator: {estimator}
"""


@pytest.mark.parametrize(
    ("second", "words", "code", "message"),
    [
        ("{plugin: ams, particles: 50}", ["--budget", "rollouts=60"], 4, "second: a budget of rollouts=60"),
        ("{plugin: mc, rollouts: 5}", [], 0, ""),
    ],
)
def test_a_mistake_in_a_later_scenario_is_reported_before_the_first_runs(
    tmp_path, monkeypatch, capsys, second, words, code, message
):
    ran, files = [], {"first": "{plugin: mc, rollouts: 5}", "second": second}
    monkeypatch.setattr("avrare.results.run.Run.write", lambda run, folder: ran.append(folder.name) or run)
    for name, estimator in files.items():
        (tmp_path / f"{name}.yaml").write_text(TANK.format(name=name, estimator=estimator))
    paths = [str(tmp_path / f"{name}.yaml") for name in files]
    assert main(["run", *paths, "--out", str(tmp_path / "out"), "--quiet", *words]) == code
    assert message in capsys.readouterr().err
    assert ran == ([] if code else ["first", "second"])


@pytest.mark.skipif(os.name != "posix", reason="needs a file where a folder should be")
def test_a_folder_that_cannot_be_created(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["run", LANE_CHANGE, *SMALL, "--out", str(tmp_path / "file" / "run")]) == 4
    assert "cannot make this folder" in capsys.readouterr().err


def test_want_of_memory_ends_with_advice(tmp_path, monkeypatch, capsys):
    def hungry(*_, **__):
        raise MemoryError

    monkeypatch.setattr("avrare.cli.run.estimate_scenario", hungry)
    scenario = str(Path(LANE_CHANGE).with_name("pendulum.yaml"))
    assert main(["run", scenario, "--out", str(tmp_path / "out"), "--no-pictures"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("out of memory\nhint: use fewer workers, a smaller chunk")
    assert "Traceback" not in told


def test_an_estimate_larger_than_the_machine_is_refused_at_once(tmp_path, capsys):
    scenario = str(Path(LANE_CHANGE).with_name("pendulum.yaml"))
    large = ["--estimator", "ams", "--set", "estimator.particles=1e9", "--set", "steps=1e6"]
    assert main(["run", scenario, *large, "--out", str(tmp_path / "out"), "--no-pictures"]) == 4
    told = capsys.readouterr().err
    assert "GiB of memory, and this process may use" in told
    assert "hint: lower particles" in told


FEW = ["--set", "estimator={plugin: mc, rollouts: 100}"]


@pytest.mark.parametrize("command", ["replay --run", "why"])
def test_where_all_rollouts_broke_down_no_failure_is_looked_for(drive, capsys, command):
    scenario = drive()
    assert main(["run", scenario, "--set", "simulator.breaks=-9", *FEW, "--out", "broken", "--quiet"]) == 6
    capsys.readouterr()
    assert main([*command.split(), "broken"]) == 4
    error = capsys.readouterr().err
    assert "broken: no failure is stored: 100 of 100 rollouts ended in an error" in error
    assert "hint: mend the stack and run it again; avrare validate --build broken/scenario.yaml" in error
    assert "no rollout failed" not in error


def test_a_few_errors_are_told_beside_the_want_of_failures(drive, capsys):
    words = ["--set", "simulator.breaks=2.5", "--set", "estimator.specifications=[on_road]"]
    assert main(["run", drive(), *words, "--out", "whole", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["replay", "--run", "whole"]) == 4
    error = capsys.readouterr().err
    assert " of 2000 rollouts ended in an error\nhint: no rollout failed; run more rollouts" in error


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("run one.yaml two.yaml --no-pictures", ["one/result.json", "two/result.json"]),
        ("check one.yaml two.yaml", ["check.json", "one/result.json"]),
        (
            "compare one.yaml --specification in_lane --estimators mc --budget steps=500",
            ["comparison.json"],
        ),
    ],
)
def test_a_reader_that_has_left_takes_no_result_along(drive, monkeypatch, capsys, words, written):
    for name in ("one", "two"):
        drive(name=name)
    read, write = os.pipe()
    os.close(read)  # as `| head -1` does
    with os.fdopen(write, "w") as unread:
        monkeypatch.setattr(sys, "stdout", unread)
        assert main([*words.split(), "--out", "bp"]) == 141
    assert "a part of the stack" not in capsys.readouterr().err
    assert all(Path("bp", name).exists() for name in written)
    assert not Path("bp/checkpoint").exists()
