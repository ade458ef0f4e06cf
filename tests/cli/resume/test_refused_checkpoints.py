"""Checkpoints that ``avrare run --resume`` refuses: damaged, of another estimate, of a later version."""

import json
from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main


@pytest.fixture(autouse=True)
def _inside(inside):
    """Run all of these in this process."""


def run(*words):
    return main(["run", *map(str, words), "--no-pictures"])


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-20],
        lambda content: content[:40],
        lambda content: b"",
        lambda content: b"\x80\x04]" + content,
        lambda content: b"PK\x03\x04" + b"0" * 500,
    ],
)
def test_a_damaged_file_is_refused(night, interrupted, capsys, damage):
    interrupted(4, night.scenario(), "--out", "torn")
    path = night.saved("torn")[2]
    path.write_bytes(damage(path.read_bytes()))
    assert run("--out", "torn", "--resume") == 4
    error = capsys.readouterr().err
    assert f"{path.name}: damaged" in error
    assert "remove this file" in error
    path.unlink()
    assert run("--out", "torn", "--resume") == 0


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


def test_an_index_of_a_later_version_is_refused(night, interrupted, capsys):
    interrupted(2, night.scenario(), "--out", "torn")
    path = Path("torn/checkpoint/checkpoint.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema": 3}))
    assert run("--out", "torn", "--resume") == 4
    assert "another version of avrare (schema 3)" in capsys.readouterr().err
