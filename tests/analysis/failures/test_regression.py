"""Known failures are driven first, and the new ones are kept."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.analysis.failures.failure import record_failure
from avrare.analysis.failures.storage import FailureDatabase
from avrare.analysis.failures.stored_replays import (
    MAX_STORED,
    check_known_failures,
    replay_failures,
    store_worst,
)
from avrare.estimation.result.result import Failures


@pytest.fixture
def failure(linear, pushed):
    return record_failure(linear, "near", pushed)


def test_outcomes_of_known_failures(load, linear, failure):
    short = replace(failure, noise=failure.noise[:5])
    gone = replace(failure, specification="gone")
    found = replay_failures(linear, [short, failure, gone])
    assert [one.outcome for one in found] == ["other error", "still fails", "other error"]
    assert found[1].robustness == failure.robustness
    assert "needs 21 x 6 numbers of noise now" in found[0].line()
    assert "no specification 'gone'" in found[2].line()
    mended = load("specifications={near: {stl: 'always (y < 90)'}}")
    [now] = replay_failures(mended, [failure])
    assert now.outcome == "passes now"
    assert now.line().startswith(f"{failure.id} near: passes now (robustness ")


def test_many_known_failures_keep_their_own_robustness(linear, pushed):
    failures = [record_failure(linear, "near", factor * pushed) for factor in np.linspace(1.0, 2.0, 7)]
    small = replay_failures(linear, failures)
    assert [one.robustness for one in small] == [failure.robustness for failure in failures]


def test_the_worst_failures_are_stored_once(linear, pushed, tmp_path):
    tapes = np.stack([factor * pushed for factor in np.linspace(1.0, 2.0, MAX_STORED + 3)] + [0.0 * pushed])
    robustness = linear.problem("near").robustness(tapes)
    database = FailureDatabase(tmp_path)
    new, complaints = store_worst(database, linear, {"near": Failures(tapes, robustness, len(tapes))})
    assert sorted(new) == database.ids()
    assert len(new) == MAX_STORED
    assert complaints == []
    kept = {database.load(name).robustness for name in new}
    assert kept == set(np.sort(robustness)[:MAX_STORED])
    assert store_worst(database, linear, {"near": Failures(tapes, robustness, len(tapes))}) == ([], [])


def test_failures_that_do_not_repeat_are_reported(linear, pushed, tmp_path, monkeypatch):
    tapes = np.stack([0.0 * pushed, pushed])  # the first failed by chance, not by its noise
    found = {"near": Failures(tapes, np.array([-1.0, -2.0]), 2)}
    new, complaints = store_worst(FailureDatabase(tmp_path), linear, found)
    assert new == [record_failure(linear, "near", pushed).id]
    assert complaints == ["near: 1 of its failures cannot be stored: they do not fail again on their noise"]
    monkeypatch.setattr(linear.stack.loop, "lacks", {"noise": "its wind is its own"})
    [line] = store_worst(FailureDatabase(tmp_path), linear, found)[1]
    assert line.endswith("they do not fail again on their noise; its wind is its own")


def test_lines_of_a_database(linear, failure, tmp_path):
    database = FailureDatabase(tmp_path)
    assert check_known_failures(database, linear) == []
    database.add(failure)
    database.add(replace(failure, scenario="other", noise=failure.noise + 1.0))
    (tmp_path / "00000000.npz").write_bytes(b"")
    complaint, line, summary = check_known_failures(database, linear)
    assert complaint.startswith(str(tmp_path / "00000000.npz"))
    assert line.startswith(f"{failure.id} near: still fails")
    assert summary == "known failures of double_integrator: 1 still fails"
