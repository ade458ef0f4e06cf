"""Checkpoints that ``avrare run --resume`` refuses: damaged, of another estimate, of a later version."""

from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main


@pytest.fixture(autouse=True)
def _inside(inside):
    """Run all of these in this process."""


def run(*words):
    return main(["run", *map(str, words), "--no-pictures"])


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
