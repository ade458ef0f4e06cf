"""History of estimates over commits: reading, storing and showing."""

import json
import os
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from avrare.analysis.history.entry import find_breaks, group_series, read_entries
from avrare.analysis.history.store import HistoryStore
from avrare.base.errors import UsageError
from avrare.cli.main import main

ESTIMATE = {
    "specification": "left", "estimator": "mc", "probability": 0.02, "interval": [0.01, 0.05],
    "confidence": 0.95, "relative_error": 0.3, "rollouts": 400, "simulated_steps": 8000, "failures": 8,
    "errors": 0, "seconds": 1.25, "health": [], "verdict": "pass",
}  # fmt: skip
DAY = 86_400
BEGIN = 1_790_000_000


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Return writer of run folders; the history lies in the current folder."""
    monkeypatch.chdir(tmp_path)

    def folder(day, name="drive", fingerprint="a" * 16, commit=None, changed=False, **changes):
        path = tmp_path / "runs" / f"{name}-{day}"
        path.mkdir(parents=True)
        content = {
            "schema": 1, "scenario": name, "fingerprint": fingerprint, "seed": 0, "versions": {},
            "estimates": [{**ESTIMATE, **changes}],
        }  # fmt: skip
        origin = {"commit": commit or f"{day:02d}" * 20, "uncommitted_changes": changed}
        (path / "result.json").write_text(json.dumps(content))
        (path / "provenance.json").write_text(json.dumps(origin))
        os.utime(path / "result.json", (BEGIN + day * DAY,) * 2)
        return str(path)

    return folder


@pytest.fixture
def told(capsys):
    """Run the history command and return its exit code and output."""

    def run(*words):
        capsys.readouterr()
        code = main(["history", *words])
        out = capsys.readouterr()
        return code, out.out, out.err

    return run


def test_added_estimates_are_read_back(write):
    folder = write(1, probability=1.25e-7, interval=[0.0, 1e-6], health=["ties", "few_roots"], verdict=None)
    (entry,) = read_entries(Path(folder))
    with HistoryStore("h.sqlite", create=True) as store:
        assert store.add([entry]) == 1
    with HistoryStore("h.sqlite") as store:
        assert store.read() == [entry]
    assert (entry.probability, entry.low, entry.health, entry.verdict) == (1.25e-7, 0.0, "ties,few_roots", "")
    assert entry.when.timestamp() == BEGIN + DAY


def test_adding_again_adds_nothing_and_time_does_not_count(write, told):
    one = write(1)
    assert told("add", one)[1].startswith("1 of 1 estimates added to .avrare/history.sqlite")
    again = write(1, name="other")
    file = Path(again) / "result.json"
    content = json.loads(file.read_text()) | {"scenario": "drive"}
    content["estimates"][0]["seconds"] = 99.0
    file.write_text(json.dumps(content))
    code, out, _ = told("add", one, again)
    assert code == 0
    assert out == "0 of 2 estimates added to .avrare/history.sqlite, 2 were stored already\n"


def test_a_folder_of_several_runs_is_added_completely(write, told):
    write(1), write(2), write(3, name="park")
    assert told("add", "runs")[1].startswith("3 of 3")


def test_the_table_is_oldest_first_and_marks_changed_fingerprints(write, told):
    for day, fingerprint in ((3, "b"), (1, "a"), (2, "a")):
        write(day, fingerprint=16 * fingerprint, changed=day == 3, probability=day / 100)
    told("add", "runs")
    code, out, _ = told("drive")
    assert code == 0
    rows = [line.split() for line in out.splitlines() if line.startswith("20")]
    assert [row[2] for row in rows] == ["0101010101", "0202020202", "0303030303*"]
    assert [row[3] for row in rows] == ["0.01", "0.02", "≠"]
    assert "* with uncommitted changes" in out
    assert max(map(len, out.splitlines())) <= 80


def test_the_limit_keeps_the_newest_of_each(write, told):
    for day in range(1, 6):
        write(day), write(day, name="park")
    told("add", "runs")
    found = json.loads(told("--limit", "2", "--json")[1])["entries"]
    assert [(one["scenario"], one["revision"][:2]) for one in found] == [
        ("drive", "04"), ("drive", "05"), ("park", "04"), ("park", "05"),
    ]  # fmt: skip
    assert len(json.loads(told("--limit", "0", "--json")[1])["entries"]) == 10
    assert told("--limit", "-1")[0] == 4


def test_health_warnings_are_shown(write, told):
    told("add", write(1, health=["ties"]))
    assert "health warnings: ties" in told()[1]


def test_series_break_between_different_fingerprints(write):
    found = [read_entries(Path(write(day, fingerprint=16 * mark)))[0] for day, mark in enumerate("aabba")]
    assert find_breaks(found) == [False, False, True, False, True]
    assert [key for key, _ in group_series(found[::-1])] == [("drive", "left")]
    assert next(iter(group_series(found[::-1])))[1] == found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["drive"], "there is no history file"),
        (["add"], "DIR is required"),
        (["add", "nowhere"], "no result.json in it"),
        (["one", "two"], "give one scenario, not 2"),
    ],
)
def test_wrong_arguments_are_a_clear_error(tmp_path, monkeypatch, told, words, message):
    monkeypatch.chdir(tmp_path)
    code, _, err = told(*words)
    assert code == 4
    assert message in err


def test_unknown_names_get_a_suggestion(write, told):
    told("add", write(1))
    assert "did you mean 'drive'" in told("drivee")[2]
    assert "did you mean 'left'" in told("--specification", "lef")[2]


def test_a_file_that_is_not_a_history(tmp_path, monkeypatch, told, write):
    (tmp_path / "x.sqlite").write_text("this is no database, but long enough to look like one" * 30)
    code, _, err = told("--store", "x.sqlite")
    assert code == 4
    assert "file is not a database" in err
    sqlite3.connect(tmp_path / "empty.sqlite").executescript("CREATE TABLE t (x)")
    code, _, err = told("--store", "sqlite:///empty.sqlite")
    assert code == 4
    assert "no such table" in err


def test_a_damaged_estimate(write, told):
    code, _, err = told("add", write(1, interval=None))
    assert code == 4
    assert "it cannot be read: estimates.0.interval: " in err


def test_any_database_of_sqlalchemy(write, told):
    pytest.importorskip("sqlalchemy")
    write(1), write(2)
    url = "sqlite+pysqlite:///other.db"
    assert told("--store", url)[0] == 4
    assert told("add", "runs", "--store", url)[1].startswith("2 of 2")
    assert told("add", "runs", "--store", url)[1].startswith("0 of 2")
    with HistoryStore(url) as by_alchemy, HistoryStore("other.db") as by_file:
        assert sorted(by_alchemy.read(), key=str) == sorted(by_file.read(), key=str)
        assert [entry.specification for entry in by_file.read("drive")].count("left") == 2


def test_a_store_that_cannot_be_reached_keeps_its_password(write, told):
    pytest.importorskip("sqlalchemy")
    _, _, err = told("--store", "nosuchdb://me:secret@host/name")
    assert "nosuchdb://host/name" in err
    assert "secret" not in err


def test_without_sqlalchemy_the_pip_line_is_given(write, told, monkeypatch):
    monkeypatch.setitem(sys.modules, "sqlalchemy", None)
    code, _, err = told("--store", "postgresql://host/name")
    assert code == 5
    assert "pip install 'avrare[history]'" in err


def test_the_picture_shows_every_estimate(write, told):
    pytest.importorskip("matplotlib")
    image = pytest.importorskip("PIL.Image")
    for day in range(4):
        write(day, verdict="fail" if day == 2 else "pass", probability=0.02 * day, interval=[0.0, 0.1])
    told("add", "runs")
    assert told("--plot", "trend.png")[0] == 0
    pixels = np.asarray(image.open("trend.png").convert("RGB")).astype(int)
    red, blue = (np.abs(pixels - colour).sum(axis=2) < 12 for colour in ([179, 50, 29], [37, 89, 184]))
    assert red.any()
    assert blue.sum() > red.sum()
    code, _, err = told("--plot", "trend.pdf")
    assert (code, "written as PNG" in err) == (4, True)


def test_an_empty_history_has_no_plot(write, told):
    pytest.importorskip("matplotlib")
    told("add", write(1))
    with sqlite3.connect(".avrare/history.sqlite") as database:
        database.execute("DELETE FROM avrare_history")
    code, _, err = told("--plot", "trend.png")
    assert (code, "--plot: the history is empty" in err) == (4, True)


def test_printed_urls_contain_no_secrets(write, told):
    pytest.importorskip("sqlalchemy")
    url = "sqlite+pysqlite:///h.db?cache=secret"
    with pytest.warns(match="not accepted"):
        code, out, err = told("add", write(1), "--store", url)
    assert (code, out, err) == (0, "1 of 1 estimates added to sqlite+pysqlite:///h.db\n", "")


def test_jobs_add_one_after_another(write, monkeypatch):
    monkeypatch.setattr("avrare.analysis.history.store._LOCK_TIMEOUT", 0.01)
    found = read_entries(Path(write(1)))
    with HistoryStore("h.sqlite", create=True) as one:
        with pytest.raises(UsageError, match="locked"):
            HistoryStore("h.sqlite", create=True)
        assert one.add(found) == 1
    with HistoryStore("h.sqlite", create=True) as two:
        assert two.add(found) == 0


RACE = """
import sys, time
from pathlib import Path
from avrare.cli.main import main
Path(sys.argv[1]).touch()
while not Path("go").exists():
    time.sleep(0.001)
sys.exit(main(["history", "add", "runs", "--store", sys.argv[2]]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("url", ["h.sqlite", "sqlite+pysqlite:///h.db"])
def test_two_jobs_that_begin_a_history_at_once_both_succeed(write, url):
    pytest.importorskip("sqlalchemy")
    for day in range(5):
        write(day)
    command, pipe = [sys.executable, "-c", RACE], subprocess.PIPE
    jobs = [
        subprocess.Popen([*command, f"ready{k}", url], stdout=pipe, stderr=pipe, text=True) for k in range(2)
    ]
    while any(job.poll() is None for job in jobs) and not all(Path(f"ready{k}").exists() for k in range(2)):
        time.sleep(0.01)
    Path("go").touch()
    said = [job.communicate() for job in jobs]
    assert [job.returncode for job in jobs] == [0, 0], said
    assert sum(int(out.split()[0]) for out, _ in said) == 5
    with HistoryStore(url) as store:
        assert len(store.read()) == 5


def test_a_concurrent_addition_by_another_job_is_not_an_error(write, monkeypatch):
    pytest.importorskip("sqlalchemy")
    found, url = read_entries(Path(write(1))), "sqlite+pysqlite:///h.db"
    with HistoryStore(url, create=True) as one:
        assert one.add(found) == 1
    with HistoryStore(url, create=True) as two:
        two._connection.create_table("CREATE TABLE avrare_history (id INTEGER)")  # it exists
        with monkeypatch.context() as patch:
            patch.setattr("avrare.analysis.history.store._TABLE", "other")
            with pytest.raises(UsageError, match="no such table: other"):
                two._connection.create_table("CREATE TABLE avrare_history (id INTEGER)")
        monkeypatch.setattr(two._connection, "run", lambda *_: [])  # it looked before the other one wrote
        assert two.add([*found, *read_entries(Path(write(2)))]) == 1
    with HistoryStore(url) as store:
        assert len(store.read()) == 2


def test_names_with_markup_and_formulas_can_be_plotted(write, told):
    pytest.importorskip("matplotlib")
    told("add", write(1, specification="[/x] $\\foo$"))
    code, out, _ = told()
    assert (code, "[/x] $\\foo$" in out) == (0, True)
    assert told("--plot", "trend.png")[0] == 0


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("written", "'2026-99-99'"), ("probability", "'high'"), ("high", "1.5"), ("verdict", "'red'"),
        ("rollouts", "2.5"), ("scenario", "CAST(x'fffe' AS TEXT)"), ("health", "x'fffe'"),
    ],
)  # fmt: skip
def test_a_damaged_entry_is_named(write, told, column, value):
    assert told("add", write(1))[0] == 0
    with sqlite3.connect(".avrare/history.sqlite") as database:
        database.execute(f"UPDATE avrare_history SET {column} = {value}")
    code, _, err = told()
    assert code == 4
    assert ".avrare/history.sqlite: " in err


def test_a_time_without_a_zone_is_read_as_universal_time(write, told):
    for day in (1, 2):
        assert told("add", write(day))[0] == 0
    with sqlite3.connect(".avrare/history.sqlite") as database:
        database.execute("UPDATE avrare_history SET written = '2026-09-23T12:00:00' WHERE rowid = 1")
    assert told("drive")[0] == 0
