"""``avrare run --resume``: what is gone on with, and what is refused."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from avrare.base import version
from avrare.cli.main import main
from avrare.estimation.loop import checkpoint
from avrare.output.terminal.progress_line import Progress


@pytest.fixture(autouse=True)
def _inside(inside):
    """Run all of these in this process."""


def run(*words):
    return main(["run", *map(str, words), "--no-pictures"])


def test_progress_continues_where_it_stopped(night, interrupted, monkeypatch):
    scenario = night.scenario()
    interrupted(7, scenario, "--out", "torn")
    seen = []
    monkeypatch.setattr(Progress, "__call__", lambda self, info: seen.append(info))
    assert run("--out", "torn", "--resume") == 0
    assert [info.rollouts for info in seen[:9]] == [10, 20, 30, 40, 50, 60, 70, 80, 90]


@pytest.mark.slow
def test_finished_chunks_are_not_run_again(night, interrupted, monkeypatch):
    """Resume two scenarios, of which splitting would run one specification after another."""
    monkeypatch.setattr("avrare.estimation.monte_carlo.monte_carlo.MonteCarlo.single", True)
    words = (night.scenario(name="one"), night.scenario(name="two"))
    assert run(*words, "--out", "whole") == 0
    interrupted(130, *words, "--out", "torn")  # 40 chunks for each of four estimates
    assert (Path("torn") / "one" / "result.json").exists()
    written, write, journal = [], checkpoint.FileJournal.write, checkpoint.FileJournal
    monkeypatch.setattr(journal, "write", lambda *args: (written.append(args[0].folder.name), write(*args)))
    assert run("--out", "torn", "--resume") == 0
    assert written == ["far"] * 30
    for name in ("one", "two"):
        assert night.result("torn", name) == night.result("whole", name)


def test_resuming_a_finished_run_prints_its_result(night, capsys):
    scenario = night.scenario()
    assert run(scenario, "--out", "done") == 0
    capsys.readouterr()
    for words in (["--out", "done", "--resume"], [scenario, "--out", "done", "--resume"]):
        assert run(*words, "--json") == 0
        out, err = capsys.readouterr()
        assert json.loads(out) == json.loads(Path("done/result.json").read_text())
        assert err == "done: this run is already finished\n"
    assert run(scenario, "--seed", "8", "--out", "done", "--resume") == 4
    assert "contains the result of another run" in capsys.readouterr().err


def test_a_finished_run_keeps_its_budget(night, capsys):
    words = [night.scenario(), "--budget", "rollouts=20"]
    assert run(*words, "--out", "done") == 0
    assert run(*words, "--out", "done", "--resume") == 0
    assert run("--out", "done", "--resume") == 0
    assert run("--out", "done", "--resume", "--budget", "rollouts=40") == 4
    assert "finished, with a budget of rollouts=20" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["", "[]", '{"budget": "rollouts=no"}'])
def test_a_damaged_provenance_does_not_hide_a_finished_run(night, capsys, content):
    words = [night.scenario(), "--budget", "rollouts=20"]
    assert run(*words, "--out", "done") == 0
    Path("done/provenance.json").write_text(content)
    assert run("--out", "done", "--resume") == 0
    assert "this run is already finished" in capsys.readouterr().err
    assert run(*words, "--out", "done", "--resume") == 4
    assert "finished, with a budget of its own options" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "change"),
    [
        (["--set", "simulator.dt=0.5"], "scenarios.walk.simulator.dt 1.0 -> 0.5"),
        (["--seed", "7"], "scenarios.walk.seed 0 -> 7"),
        (["--set", "chunk=20"], "scenarios.walk.chunk 10 -> 20"),
        (["--set", "estimator.rollouts=500"], "scenarios.walk.estimator.rollouts 400 -> 500"),
        (["--budget", "rollouts=100"], 'budget null -> "rollouts=100.0"'),
        (["--set", "specifications.far.stl=always (x < 2)"], '"always (x < 1.2)" -> "always (x < 2)"'),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_another_task_is_refused_by_what_differs(night, interrupted, capsys, words, change, named):
    scenario = night.scenario()
    interrupted(2, scenario, "--out", "torn")
    assert run(*([scenario] if named else []), "--out", "torn", "--resume", *words) == 4
    assert change in capsys.readouterr().err
    assert len(night.saved("torn")) == 2
    assert run("--out", "torn", "--resume") == 0


@pytest.mark.parametrize(
    "words", [["--seed", "8"], ["--set", "simulator.scale=0.2"], ["--estimator", "ams"], ["--set", "no=1"]]
)
def test_a_finished_run_is_not_taken_for_another(night, words, capsys):
    assert run(night.scenario(), "--out", "done") == 0
    assert run("--out", "done", "--resume", *words) == 4
    assert run("--out", "done", "--resume", "--set", "chunk=10") == 0
    assert "this run is already finished" in capsys.readouterr().err


def test_a_scenario_begins_in_a_folder_that_is_not_there(night, capsys):
    scenario = night.scenario()
    assert run(scenario, "--out", "new/night", "--resume") == 0
    assert "new/night: nothing to resume there yet: this is the beginning\n" in capsys.readouterr().err
    assert run("--out", "new/night", "--resume") == 0
    Path("file").write_text("")
    assert run(scenario, "--out", "file", "--resume") == 4
    assert "--out file: is not a folder" in capsys.readouterr().err


def test_other_versions_are_refused(night, interrupted, capsys, monkeypatch):
    interrupted(2, night.scenario(), "--out", "torn")
    own = version.__version__
    monkeypatch.setattr(version, "__version__", "0.2.0")
    assert run("--out", "torn", "--resume") == 4
    assert f'scenarios.walk.versions.avrare "{own}" -> "0.2.0"' in capsys.readouterr().err


def test_changed_code_is_found_by_replaying_a_rollout(night, interrupted, capsys, monkeypatch):
    interrupted(2, night.scenario(), "--out", "torn")
    monkeypatch.setenv("AVRARE_TOY_BUG", "1")
    assert run("--out", "torn", "--resume") == 4
    error = capsys.readouterr().err
    assert "does not reproduce: robustness" in error
    assert "the code or its libraries have changed" in error
    monkeypatch.delenv("AVRARE_TOY_BUG")
    assert run("--out", "torn", "--resume") == 0


def test_an_interrupted_run_is_not_overwritten(night, interrupted, capsys):
    scenario = night.scenario()
    interrupted(2, scenario, "--out", "torn")
    assert run(scenario, "--out", "torn") == 4
    told = "torn: contains an interrupted run\nhint: resume with avrare run --out torn --resume;"
    assert told in capsys.readouterr().err
    assert len(night.saved("torn")) == 2


def test_a_report_tells_of_an_interrupted_run_in_its_folder_or_beside_it(night, interrupted, capsys):
    assert run(night.scenario(), "--out", "twice") == 0
    interrupted(2, night.scenario(), "--out", "twice")
    assert run(night.scenario(), "--out", "twice/one") == 0
    for folder in ("twice", "twice/one"):
        assert main(["report", folder]) == 0
        error = capsys.readouterr().err
        assert error.count("twice: contains an interrupted run as well, which the report does not show") == 1
        assert "avrare run --out twice --resume" in error


def test_a_run_that_saved_nothing_is_overwritten(night):
    scenario = night.scenario()
    assert run(scenario, "--out", "done") == 0
    assert run(scenario, "--out", "done") == 0
    checkpoint.Checkpoint.open(Path("empty/checkpoint"), {"another": "task"})
    assert run(scenario, "--out", "empty") == 0
    assert night.result("empty") == night.result("done")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "nowhere", "--resume"], "no such folder"),
        (["--out", ".", "--resume"], "contains no interrupted run"),
        (["--resume"], "--resume requires --out"),
        ([], "SCENARIO is required"),
    ],
)
def test_nothing_to_resume(words, message, capsys):
    assert run(*words) == 4
    assert message in capsys.readouterr().err


def test_a_full_disk(night, capsys, monkeypatch):
    scenario, replace, calls = night.scenario(), os.replace, []
    assert run(scenario, "--out", "whole") == 0

    def full(source, target):
        calls.append(target)
        if len(calls) > 8:
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        assert run(scenario, "--out", "torn") == 2
    assert "cannot save: No space left on device" in capsys.readouterr().err
    assert len(night.saved("torn")) == 6  # beside the index and the scenario
    assert run("--out", "torn", "--resume") == 0
    assert night.result("torn") == night.result("whole")


def test_leftovers_of_a_killed_process_are_removed(night, interrupted, monkeypatch):
    interrupted(2, night.scenario(), "--out", "torn")
    first = night.saved("torn")[0]
    (first.parent / f".{first.name}.x1y2").write_bytes(b"half a fi")
    write, seen, journal = checkpoint.FileJournal.write, [], checkpoint.FileJournal
    monkeypatch.setattr(journal, "write", lambda *args: (seen.extend(first.parent.glob(".*")), write(*args)))
    assert run("--out", "torn", "--resume") == 0
    assert seen == []


@pytest.mark.parametrize("several", [False, True])
def test_a_refused_run_leaves_nothing(night, several):
    words = [night.scenario("{plugin: ams, particles: 50, discard: 10}")]
    words += [night.scenario(name="two")] if several else []
    assert run(*words, "--budget", "rollouts=10") == 4
    assert not list(Path().glob("runs/*"))
    assert run(*words, "--budget", "rollouts=10", "--out", "kept") == 4
    assert not Path("kept").exists()


def test_only_one_process_resumes_in_a_folder(night, interrupted, capsys):
    scenario = night.scenario()
    interrupted(2, scenario, "--out", "torn")
    with checkpoint.Checkpoint(Path("torn/checkpoint"), {}).hold():
        for words in (["--resume"], [scenario, "--resume"], [scenario]):
            capsys.readouterr()
            assert run(*words, "--out", "torn") == 4
            assert "another process is using this folder" in capsys.readouterr().err
    assert len(night.saved("torn")) == 2
    assert run("--out", "torn", "--resume") == 0


@pytest.mark.slow
def test_a_run_stopped_in_its_cross_check_goes_on_there(night, interrupted, capsys):
    estimator = "{plugin: ams, particles: 90, discard: 20, runs: 2}"
    words = [night.scenario(estimator), "--set", "cross_check={estimator: ess, share: 1.0}"]
    assert run(*words, "--out", "whole") == 0
    lines = capsys.readouterr().out
    assert "near: Cross-check by ess " in lines
    assert "far: Cross-check by ess " in lines
    interrupted(80, *words, "--out", "torn")
    folders = {path.parent.name for path in night.saved("torn")}
    assert "near+check" in folders
    assert run("--out", "torn", "--resume") == 0

    def content(out):
        found = night.result(out)
        for entry in found["estimates"]:
            assert entry["cross_check"]["result"]["rollouts"] > 0
            del entry["cross_check"]["result"]["seconds"]
        return found

    assert content("torn") == content("whole")


def test_results_of_other_scenarios_are_not_mixed_with(night, capsys):
    one, two, three = (night.scenario(name=name) for name in ("one", "two", "three"))
    assert run(one, two, "--out", "both") == 0
    assert run(one, two, "--out", "both", "--seed", "3") == 0
    assert run(one, "--out", "single") == 0
    assert run(one, "--out", "single", "--set", "simulator.scale=0.2") == 0
    assert run(three, "--out", "both/own") == 0  # a run of its own inside is no part of the other
    assert run(one, two, "--out", "both") == 0
    capsys.readouterr()
    for words, told in (
        ([one, three, "--out", "both"], "both/two: contains the result of another run, of two"),
        ([three, "--out", "both"], "both/one: contains the result of another run, of one"),
        ([two, "--out", "single"], "single: contains the result of another run, of one"),
        ([one, two, "--out", "single"], "single: contains the result of another run, of one"),
    ):
        assert run(*words) == 4
        assert capsys.readouterr().err.startswith(f"{told}\nhint: choose another folder, or remove")
    assert sorted(path.name for path in Path("both").iterdir()) == ["one", "own", "two"]
    assert not any(path.is_dir() for path in Path("single").iterdir())


def test_a_folder_with_an_interrupted_run_inside_is_not_finished(night, interrupted, capsys):
    one, two = night.scenario(name="one"), night.scenario(name="two")
    assert run(one, two, "--out", "both") == 0
    interrupted(2, two, "--seed", "3", "--out", "both/two")
    capsys.readouterr()
    assert run("--out", "both", "--resume") == 4
    assert capsys.readouterr().err == (
        "both/two: contains an interrupted run of its own\n"
        "hint: resume with avrare run --out both/two --resume\n"
    )
    assert run("--out", "both/two", "--resume") == 0
    assert run("--out", "both", "--resume") == 0
    assert "already finished" in capsys.readouterr().err


def test_the_file_of_another_chunk_is_refused(night, interrupted, capsys):
    interrupted(4, night.scenario(), "--out", "torn")
    first, *_, last = night.saved("torn")
    last.write_bytes(first.read_bytes())
    assert run("--out", "torn", "--resume") == 4
    assert "belongs to another estimate" in capsys.readouterr().err


def test_nothing_is_unpickled(night, interrupted, capsys):
    interrupted(2, night.scenario(), "--out", "torn")
    path = night.saved("torn")[1]
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(path, **{**arrays, "messages": np.array([{"an": "object"}], dtype=object)})
    assert run("--out", "torn", "--resume") == 4
    assert "damaged: it holds something else than arrays" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": 1}', '{"schema": 1, "task": 3, "about": {}}'])
def test_a_damaged_index_is_refused(night, interrupted, capsys, text):
    interrupted(2, night.scenario(), "--out", "torn")
    Path("torn/checkpoint/checkpoint.json").write_text(text)
    assert run("--out", "torn", "--resume") == 4
    err = capsys.readouterr().err
    reason = "this is not a checkpoint" if text.startswith('{"') else "cannot be read: "
    assert f"checkpoint.json: {reason}" in err
    assert "start afresh in another folder" in err
