"""``avrare compare`` as a user meets it."""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest

from avrare.analysis.compare import study
from avrare.cli.main import main

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
WALK = ["compare", "problem:d_rw_L2.5", "--estimators", "mc,ams:particles=50:discard=10"]
SMALL = ["--budget", "steps=1e5", "--repeat", "3"]
FIELDS = {
    "schema", "comparison", "specification", "fingerprint", "versions", "steps", "budget", "repeat", "seed",
    "confidence", "truth", "interrupted", "disagree", "estimators",
}  # fmt: skip
SUMMARY = {
    "repetitions", "mean", "interval", "steps", "rollouts", "simulations", "zeros", "warned", "warnings",
    "accuracy",
}  # fmt: skip
ACCURACY = {
    "ratio", "covered", "covered_interval", "relative_rmse", "work", "work_interval", "missed", "speed_up",
    "speed_up_interval",
}  # fmt: skip
REPETITION = {
    "seed", "probability", "interval", "relative_error", "rollouts", "simulated_steps", "failures", "errors",
    "health", "seconds",
}  # fmt: skip


def test_a_comparison_says_beforehand_how_long_it_takes(capsys):
    words = ["compare", "problem:d_rw_L2.5", "--estimators", "mc", "--repeat", "2"]
    assert main([*words, "--budget", "rollouts=200", "--plain"]) == 0
    assert capsys.readouterr().err.startswith("2 estimates of 200 rollouts: under 1 s or more\n")


@pytest.mark.slow
def test_a_reference_problem(tmp_path, capsys):
    assert main([*WALK, *SMALL, "--out", str(tmp_path / "new" / "folder"), "--seed", "4"]) == 0
    screen = capsys.readouterr().out
    for part in ("p = 0.01062 (exact)", "100,000 steps", "3 repetitions from seed 4", ":discard=10", "3/3"):
        assert part in screen
    assert max(map(len, screen.splitlines())) <= 100
    folder = tmp_path / "new" / "folder"
    assert "| `ams:particles=50:discard=10` |" in (folder / "comparison.md").read_text()
    content = json.loads((folder / "comparison.json").read_text())
    assert set(content) == FIELDS
    assert content["truth"]["probability"] == 0.010618888379036615
    for entry in content["estimators"]:
        assert set(entry["summary"]) == SUMMARY
        assert set(entry["summary"]["accuracy"]) == ACCURACY
        assert [set(one) for one in entry["repetitions"]] == [REPETITION] * 3
        assert [one["seed"] for one in entry["repetitions"]] == [4, 5, 6]
    assert content["estimators"][0]["summary"]["steps"] == 100_000
    if find_spec("matplotlib"):
        assert (folder / "comparison.png").read_bytes().startswith(b"\x89PNG")


def test_problem_without_an_id_lists_reference_problems(capsys):
    assert main(["compare", "problem:"]) == 0
    assert "d_rw_L3.8" in capsys.readouterr().out


def test_an_interruption_shows_finished_repetitions_and_exits_2(monkeypatch, capsys, tmp_path):
    real, calls = study.run, []

    def run(*args):
        calls.append(args)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(study, "run", run)
    assert main([*WALK, *SMALL, "--out", str(tmp_path), "--no-pictures"]) == 2
    assert "interrupted: 1 of 3 repetitions are complete" in capsys.readouterr().out
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert content["interrupted"]
    assert [len(entry["repetitions"]) for entry in content["estimators"]] == [2, 1]


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["problem:d_rw_L9", "--estimators", "mc", *SMALL], 4, "did you mean 'd_rw_L"),
        (["problem:d_rw_L2.5", *SMALL], 4, "--estimators is required"),
        (["problem:d_rw_L2.5", "--estimators", "mc"], 4, "--budget is required"),
        (["problem:d_rw_L2.5", "--estimators", "mc", "--budget", "steps=99"], 4, "mc: a budget of steps=99"),
        (["problem:d_rw_L2.5", "--estimators", "amss", *SMALL], 5, "'ams'"),
        ([*WALK[1:], *SMALL, "--set", "scenario.steps=3"], 4, "setting scenario.KEY"),
        (["problem:d_rw_L2.5", "--estimators", "ce", *SMALL], 4, "no estimator can take"),
        ([LANE_CHANGE, "--estimators", "mc", *SMALL], 4, "choose one"),
        ([LANE_CHANGE, "--estimators", "mc", *SMALL, "--specification", "no_colision"], 4, "no_collision"),
    ],
)
def test_wrong_arguments_are_a_clear_error(capsys, words, code, message):
    assert main(["compare", *words]) == code
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_a_folder_that_cannot_be_created_is_reported_before_anything_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("avrare.cli.compare.compare", pytest.fail)
    words = ["--budget", "steps=1e4", "--repeat", "2", "--out", str(tmp_path / "file" / "run")]
    assert main(["compare", "problem:d_rw_L2.5", "--estimators", "mc", *words]) == 4
    assert "cannot write" in capsys.readouterr().err
    monkeypatch.setattr("avrare.cli.compare.compare_versions", pytest.fail)
    words = ["--against", LANE_CHANGE, "--out", str(tmp_path / "file" / "run")]
    assert main(["compare", LANE_CHANGE, *words]) == 4
    assert "cannot write" in capsys.readouterr().err


def test_quiet_prints_one_line_per_estimator(capsys):
    few = ["--budget", "steps=2e4", "--repeat", "2", "--quiet"]
    assert main([*WALK, *few]) == 0
    found = capsys.readouterr()
    names = [line.rpartition(": ")[0] for line in found.out.splitlines()]
    assert names == ["mc", "ams:particles=50:discard=10"]
    assert all(".." in line for line in found.out.splitlines())
    assert found.err == ""
    assert main([*WALK, *few, "--plain"]) == 4


def test_versions_that_differ_in_more_than_the_stack_are_told(capsys):
    tank = str(Path(__file__).parents[2] / "scenarios" / "double_integrator.yaml")
    words = ["compare", tank, "--against", tank, "--budget", "rollouts=20", "--set", "scenario.steps=5"]
    assert main(words) == 0
    assert "that of the stack alone" not in capsys.readouterr().out
    rule = 'against.specifications.clear.stl="always (x < 0.5)"'
    assert main([*words, "--set", rule, "--set", "against.simulator.initial.mean=[0.1, 0, 1, 0]"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "clear: the two versions judge by different rules: the change is not that of the stack" in out
    assert "the two versions have different simulators" in out
