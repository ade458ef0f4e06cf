"""Damaged files of a run's folder: one message each, whatever is in them."""

import json
import os
import zlib

import numpy as np
import pytest

from avrare.base import stored_files
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_arrays, read_json, write_arrays
from avrare.results.run import Run
from avrare.results.stored_results import read_failures, read_rollouts

ESTIMATE = {
    "specification": "left", "estimator": "mc", "probability": 0.02, "interval": [0.01, 0.05],
    "confidence": 0.95, "relative_error": None, "rollouts": 400, "simulated_steps": 8000, "failures": 8,
    "errors": 0, "seconds": 1, "health": [], "notes": [], "verdict": "pass",
}  # fmt: skip
RESULT = {"schema": 1, "scenario": "drive", "fingerprint": "a", "seed": 0, "versions": {}}


def write(folder, **changes):
    estimate = {key: value for key, value in {**ESTIMATE, **changes}.items() if value != "gone"}
    (folder / "result.json").write_text(json.dumps({**RESULT, "estimates": [estimate]}))


def test_what_a_run_writes_is_read(tmp_path):
    write(tmp_path, diagnostics={"levels": [[None]]}, run_probabilities=[0.1, None])
    assert np.array_equal(Run.read(tmp_path)["left"].run_probabilities, [0.1, np.nan], equal_nan=True)


@pytest.mark.parametrize("key", ESTIMATE)
@pytest.mark.parametrize("value", ["gone", {}, [[]], -1.5, float("nan")])
def test_an_estimate_without_its_numbers_is_reported(tmp_path, key, value):
    if key in ("relative_error", "seconds") and value == -1.5:
        return
    write(tmp_path, **{key: value})
    with pytest.raises(UsageError, match=rf"result\.json: it cannot be read: estimates\.0\.{key}"):
        Run.read(tmp_path)


def test_fields_are_read_as_they_were_written(tmp_path):
    fields = {"trials": 90, "members": 3, "shared_by": 2, "error_share": 0.1}
    write(tmp_path, **fields)
    entry = Run.read(tmp_path)["left"].to_dict()
    assert {name: entry[name] for name in fields} == fields


@pytest.mark.parametrize(
    ("note", "place"),
    [
        ({"text": "The goal was reached."}, "kind"),
        ({"kind": 3, "text": "The goal was reached."}, "kind"),
        ({"kind": "goal"}, "text"),
        ({"kind": "goal", "text": 3}, "text"),
    ],
)
def test_damaged_notes_are_reported(tmp_path, note, place):
    write(tmp_path, notes=[{"kind": "goal", "text": "The goal was reached."}, note])
    with pytest.raises(UsageError, match=rf"it cannot be read: estimates\.0\.notes\.1\.{place}: "):
        Run.read(tmp_path)


def test_a_result_without_estimates(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps({**RESULT, "estimates": []}))
    with pytest.raises(UsageError, match="it cannot be read: estimates: "):
        Run.read(tmp_path)


def test_any_damaged_byte_of_an_archive_is_reported_or_harmless(tmp_path):
    path, rng = tmp_path / "x.npz", np.random.default_rng(0)
    np.savez_compressed(path, a=rng.standard_normal(400), header=np.array("text"))
    whole, told = path.read_bytes(), []
    for place in range(0, len(whole), 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            read_arrays(path, "remove it")
        except UsageError as error:
            told.append(error)
    assert {error.hint for error in told} == {"remove it"}
    assert zlib.error in {type(error.__cause__.__cause__) for error in told}


def store(path, fields):
    np.savez(path, **{f"left.{key}": value for key, value in fields.items()})


@pytest.mark.parametrize(
    "changes",
    [
        {"robustness": np.zeros(3)}, {"noise": np.zeros((2, 5))}, {"count": np.zeros(2, dtype=int)},
        {"noise": np.full((2, 5, 1), np.nan)}, {"robustness": np.array(["a", "b"])},
        {"noise": np.zeros((0, 5, 1)), "robustness": np.zeros(0)},
    ],
)  # fmt: skip
def test_failures_with_inconsistent_shapes(tmp_path, changes):
    fields = {"noise": np.zeros((2, 5, 1)), "robustness": np.zeros(2), "count": np.array(7)}
    store(tmp_path / "failures.npz", fields)
    assert read_failures(tmp_path)["left"].count == 7
    store(tmp_path / "failures.npz", fields | changes)
    with pytest.raises(UsageError, match="left is damaged"):
        read_failures(tmp_path)


@pytest.mark.parametrize(
    "changes",
    [{"robustness": np.zeros((2, 2))}, {"worst": np.zeros(4)}, {"worst_robustness": np.array("low")}],
)
def test_invalid_stored_rollouts(tmp_path, changes):
    fields = {"robustness": np.zeros(2), "worst": np.zeros((5, 1)), "worst_robustness": np.array(0.5)}
    store(tmp_path / "rollouts.npz", fields)
    assert read_rollouts(tmp_path)["left"].worst.robustness == 0.5
    store(tmp_path / "rollouts.npz", fields | changes)
    with pytest.raises(UsageError, match="left is damaged"):
        read_rollouts(tmp_path)


def test_the_hint_on_a_run_that_is_not_finished_names_its_folder(tmp_path):
    (tmp_path / "my run" / "checkpoint").mkdir(parents=True)
    with pytest.raises(UsageError) as caught:
        Run.read(tmp_path / "my run")
    assert caught.value.hint == "give the folder that `avrare run --out` has written"
    (tmp_path / "my run" / "checkpoint" / "checkpoint.json").write_text("{}")
    with pytest.raises(UsageError) as caught:
        Run.read(tmp_path / "my run")
    assert f"resume with avrare run --out '{tmp_path}/my run' --resume" in caught.value.hint


@pytest.mark.parametrize(
    "text", ['{"a": ' + "[" * 70 + "]" * 70 + "}", '{"a": "\\ud800"}', '{"a": 1' + "0" * 5000 + "}"]
)
def test_what_could_not_be_copied_or_written_again_is_refused(tmp_path, text):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(UsageError, match=r"x\.json: cannot be read"):
        read_json(tmp_path / "x.json", "remove it")


@pytest.mark.parametrize("name", ["result.json", "failures.npz", "rollouts.npz", "scenario.yaml"])
def test_a_pipe_in_place_of_a_file_does_not_hang(tmp_path, name):
    write(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    if name != "scenario.yaml":
        with pytest.raises(UsageError):
            Run.read(tmp_path)
        return
    run = Run.read(tmp_path)
    with pytest.raises(UsageError, match="its scenario cannot be built"):
        _ = run.scenario
    assert run.scenario_text == ""
    assert "not a regular file" in run.build_errors[0]


def test_a_file_that_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(stored_files, "_MAX_EXPANDED_BYTES", 2**20)
    np.savez_compressed(tmp_path / "bomb.npz", a=np.zeros(2**20))
    with pytest.raises(UsageError, match="would expand to"):
        read_arrays(tmp_path / "bomb.npz", "remove it")
    np.savez(tmp_path / "large.npz", a=np.zeros(2**20))
    assert read_arrays(tmp_path / "large.npz", "remove it")["a"].shape == (2**20,)


def test_arrays_are_written_completely_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "model"
    write_arrays(path, {"a": np.arange(3)})
    before = path.read_bytes()
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_arrays(path, {"a": np.arange(4)})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    assert np.array_equal(read_arrays(path, "fit it again")["a"], np.arange(3))
