"""``avrare replay``, ``falsify``, ``failures`` and ``run --failures`` as a user meets them."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from avrare.analysis.failures.failure import record_failure
from avrare.analysis.failures.storage import FailureDatabase
from avrare.cli.main import main
from avrare.results.stored_results import read_failures

SCENARIO = str(Path(__file__).parents[3] / "scenarios" / "double_integrator.yaml")
CHANGES = ["--set", "steps=20", "--set", "specifications={near: {stl: 'always (y < 0.2)'}}"]


@pytest.fixture
def avrare(tmp_path, monkeypatch, capsys):
    """Run a command in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def avrare(*words):
        code = main([*map(str, words)])
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        assert code != 70, err
        return code, out, err

    return avrare


@pytest.fixture
def stored(avrare, linear, pushed, tmp_path):
    """Return id of a failure in the default folder."""
    failure = record_failure(linear, "near", pushed)
    FailureDatabase(tmp_path / ".avrare" / "failures").add(failure)
    return failure.id


def run(avrare, *words):
    options = ["--estimator", "mc", "--set", "estimator.rollouts=300", *CHANGES, "--no-pictures", "--json"]
    return avrare("run", SCENARIO, *options, *words)


def test_a_run_stores_failures_and_the_next_run_replays_them_first(avrare):
    code, first, err = run(avrare, "--out", "a", "--failures", "db")
    assert code == 0
    new = re.search(r"(\d+) new failures in db", err)
    assert len(FailureDatabase(Path("db")).ids()) == int(new[1])
    assert 1 < int(new[1]) <= 10
    code, second, err = run(avrare, "--out", "b", "--failures", "db")
    assert f"known failures of double_integrator: {new[1]} still fail\n" in err
    assert "new failures" not in err
    code, third, _ = run(avrare, "--out", "c")
    contents = [json.loads(text) for text in (first, second, third)]
    for content in contents:
        content["estimates"][0].pop("seconds")
    assert contents[0] == contents[1] == contents[2]


@pytest.mark.slow
def test_a_blob_is_reproduced_in_a_fresh_process(avrare, stored, tmp_path):
    code, blob, _ = avrare("failures", "blob", stored)
    assert code == 0
    Path("blob.txt").write_text(blob)
    for word in (blob.strip(), "@blob.txt"):
        command = [sys.executable, "-m", "avrare", "replay", SCENARIO, *CHANGES, "--blob", word]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert f"failure {stored} is reproduced" in done.stdout
        assert "bit-identical" in done.stdout


def test_a_corrected_scenario_exits_with_1(avrare, stored):
    mended = "simulator.process_noise=[1e-9, 1e-9, 1e-9, 1e-9]"
    code, out, _ = avrare("replay", SCENARIO, *CHANGES, "--set", mended, "--failure", stored)
    assert code == 1
    assert "does not fail now: near holds" in out
    assert "the signals differ from step 1 on" in out
    assert "simulator differs: fingerprint " in out


def test_the_failures_of_a_run(avrare):
    run(avrare, "--out", "a")
    worst = int(np.argmin(read_failures(Path("a"))["near"].robustness))
    for words in ((), ("--failure", worst)):
        code, out, _ = avrare("replay", "--run", "a", *words)
        assert code == 0
        assert "the robustness is bit-identical" in out
    assert avrare("replay", "--run", "a", "--write-blob", "worst.txt", "--failures", "db")[0] == 0
    code, out, _ = avrare("replay", "a/scenario.yaml", "--blob", "@worst.txt")
    assert (code, "the signals are bit-identical" in out) == (0, True)
    code, out, _ = avrare("failures", "add", "a")
    assert re.match(r"10 new failures in \.avrare/failures: ", out)
    assert avrare("failures", "add", "a")[1] == "no new failures\n"
    code, out, _ = avrare("failures", "list")
    assert len(out.splitlines()) == 10
    assert all("double_integrator  near  robustness -" in line for line in out.splitlines())


def test_shrinking_stores_what_is_left(avrare, stored):
    code, out, _ = avrare(
        "replay", SCENARIO, *CHANGES, "--failure", stored, "--shrink", "--budget", "rollouts=400"
    )
    assert code == 0
    ratio = float(re.search(r"shrunk to ([\d.]+)% of its norm", out)[1])
    assert ratio < 60.0
    assert "it needs only: process noise of vy" in out
    [small] = [name for name in FailureDatabase(Path(".avrare/failures")).ids() if name != stored]
    assert f"stored as {small}; avrare replay {SCENARIO}" in out
    code, out, _ = avrare("replay", SCENARIO, *CHANGES, "--failure", small)
    assert (code, "bit-identical" in out) == (0, True)


def test_the_exported_rollout_breaks_the_same_formula(avrare, stored):
    code, out, _ = avrare("replay", SCENARIO, *CHANGES, "--failure", stored, "--export", "f.csv")
    robustness = float(re.search(r"robustness (\S+)", out)[1])
    code, out, _ = avrare("monitor", "f.csv", "--stl", "always (y < 0.2)", "--json")
    assert code == 1
    assert json.loads(out)["robustness"] == pytest.approx(robustness, rel=1e-5)


@pytest.mark.slow
def test_falsify_finds_prints_and_stores_a_failure(avrare):
    words = ["falsify", SCENARIO, *CHANGES, "--budget", "rollouts=900", "--write-blob", "found.txt"]
    code, out, _ = avrare(*words)
    assert code == 1
    norm = float(re.search(r"most likely failure found: norm (\S+)", out)[1])
    first = float(re.search(r"first failure after \d+ rollouts, norm (\S+)", out)[1])
    assert norm < 0.6 * first
    assert f"beta = {norm:.3g}" in out
    assert "beta^2/2) neither estimates nor bounds the failure probability" in out
    assert avrare(*words)[1] == out
    assert avrare("replay", SCENARIO, *CHANGES, "--blob", "@found.txt")[0] == 0


def test_json_and_quiet_print_the_answer_alone(avrare, stored):
    code, out, err = avrare("replay", SCENARIO, *CHANGES, "--failure", stored, "--json", "--export", "f.csv")
    answer = json.loads(out)
    assert (code, answer["failure"], answer["outcome"]) == (0, stored, "fails")
    assert "written to f.csv" in err
    words = ["falsify", SCENARIO, *CHANGES, "--budget", "rollouts=900"]
    _, out, _ = avrare(*words, "--quiet")
    assert len(out.splitlines()) == 1
    code, out, err = avrare(*words, "--json")
    assert code == 1
    assert json.loads(out)["beta"] > 0.0
    assert "stored as" in err


def test_falsify_that_finds_nothing(avrare):
    impossible = "specifications={far: {stl: 'always (y < 1e6)'}}"
    code, out, _ = avrare(
        "falsify", SCENARIO, "--set", impossible, "--set", "steps=5", "--budget", "rollouts=150"
    )
    assert code == 0
    assert "no failure found in 150 rollouts" in out
    assert not Path(".avrare").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["replay"], "SCENARIO is required"),
        (["replay", SCENARIO], "name one failure: --failure, --blob or --run"),
        (["replay", SCENARIO, "--failure", "abc"], "unknown failure 'abc'"),
        (["replay", SCENARIO, "--blob", "hello"], "not a failure blob"),
        (["replay", SCENARIO, "--failure", "abc", "--specification", "x"], "--specification requires --run"),
        (["replay", "--run", "none"], "none: no result.json in it"),
        (["replay", SCENARIO, "--failure", "a", "--budget", "rollouts=0"], "--budget"),
        (["replay", "--run", "none", "--blob", "x"], "--blob cannot be combined with --run"),
        (["falsify", SCENARIO, "--seed", "-1"], "--seed must be at least 0"),
        (["falsify", SCENARIO, "--specification", "clean"], "unknown specification 'clean'"),
    ],
)
def test_mistakes_are_one_clear_line(avrare, words, text):
    code, out, err = avrare(*words)
    assert (code, out) == (4, "")
    assert text in err
    assert len(err.splitlines()) <= 2


def test_a_folder_that_cannot_store_failures_is_reported_before_the_run(avrare, tmp_path):
    (tmp_path / "file").touch()
    code, _, err = run(avrare, "--out", "a", "--failures", "file")
    assert (code, "not a writable folder" in err) == (4, True)
    assert not (tmp_path / "a" / "result.json").exists()


def test_an_export_without_its_distribution_is_refused_before_the_replay(avrare, stored, monkeypatch):
    monkeypatch.setattr("avrare.plugin.provided.entry_points", lambda **names: [])
    monkeypatch.setattr("avrare.cli.replay.replay", None)  # not called
    code, _, err = avrare("replay", SCENARIO, *CHANGES, "--failure", stored, "--export", "x.csv")
    assert code == 5
    assert "avrare.export is provided by avrare-recordings" in err
