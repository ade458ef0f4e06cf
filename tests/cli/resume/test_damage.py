"""Whatever is in a damaged file, the command says so, or gives the result of the undamaged one.

``AVRARE_DAMAGES=1000`` tries a thousand of each kind instead of a few.
"""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import damage
from avrare.cli.main import main

FIRST = Path(__file__).parents[2] / "data" / "first_release"
MANY = int(os.environ.get("AVRARE_DAMAGES", "4"))
FILES = {
    "result": ("run/result.json", damage.damage_json),
    "provenance": ("run/provenance.json", damage.damage_json),
    "failures": ("run/failures.npz", damage.damage_arrays),
    "rollouts": ("run/rollouts.npz", damage.damage_arrays),
    "baseline": ("baselines/0001.json", damage.damage_json),
    "stored failure": ("failures/198c4495.npz", damage.damage_arrays),
}
COMMANDS = {
    "result": [
        "report first/run", "history add first/run --store new.sqlite", "run --resume first/run",
        "run --resume first/run --json", "replay first/walk.yaml --run first/run --specification far",
        "failures add --from first/run --failures new",
    ],
    "provenance": ["report first/run", "history add first/run --store new.sqlite", "run --resume first/run"],
    "failures": [
        "report first/run", "replay first/walk.yaml --run first/run --specification far",
        "failures add --from first/run --failures new",
    ],
    "rollouts": ["report first/run"],
    "baseline": ["check first/walk.yaml --baseline first/baselines --set estimator.rollouts=200 --plan"],
    "stored failure": [
        "failures list --failures first/failures", "failures print 198c4495 --failures first/failures",
        "replay first/walk.yaml --failure 198c4495 --failures first/failures",
        "failures cluster first/walk.yaml --failures first/failures",
    ],
}  # fmt: skip


def copy_first(folder):
    shutil.rmtree(folder / "first", ignore_errors=True)
    shutil.copytree(FIRST, folder / "first")
    return folder / "first"


def call(command, capsys, told):
    code = main(command.split())
    out, err = capsys.readouterr()
    assert code in (0, 1, 3, 4), (told, command, code, err)
    assert "Traceback" not in err, (told, command, err)
    assert "\x1b" not in out + err, (told, command)
    return code, err


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_a_damaged_file_is_read_or_named(inside, kind, capsys):
    name, change = FILES[kind]
    for seed in range(MANY):
        first, random = copy_first(inside.folder), np.random.default_rng([seed, len(kind)])
        path = first / name
        path.write_bytes(change(path.read_bytes(), random))
        command = COMMANDS[kind][random.integers(len(COMMANDS[kind]))]
        for new in (inside.folder / "new.sqlite", inside.folder / "new"):
            shutil.rmtree(new, ignore_errors=True) if new.is_dir() else new.unlink(missing_ok=True)
        call(command, capsys, (kind, seed))
        for page in (inside.folder / "first" / "run").glob("*.html"):
            assert "\x1b" not in page.read_text(), (kind, seed)
            assert "<script>alert" not in page.read_text(), (kind, seed)


@pytest.mark.slow
def test_a_damaged_history_is_read_or_named(inside, capsys):
    for seed in range(MANY):
        first, random = copy_first(inside.folder), np.random.default_rng(seed)
        path = first / "history.sqlite"
        path.write_bytes(damage.damage_history(path.read_bytes(), random, inside.folder / "scratch"))
        command = ["history walk", "history walk --json", "history", "history add first/run"][seed % 4]
        call(f"{command} --store first/history.sqlite", capsys, seed)
