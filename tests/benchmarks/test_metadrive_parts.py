"""Parts of an estimate are one estimate: counts add up, and runs stand beside each other. And a score."""

import itertools

import numpy as np
import pytest
from metadrive_study import LEAST_REWARD, LEAST_SPEED, danger
from studies import metadrive_parts as parts

from avrare.estimation.result import intervals
from avrare.testing.static_problems import linear

MC = {"rollouts": 40, "scenario": "a"}
ESS = {"chains": 10, "level_probability": 0.25, "runs": 1}


def finished(folder, name, options, count, problem=None):
    clock = itertools.count(step=60).__next__
    parts.run(problem or linear(1.5, dim=5).problem(), name, options, count, folder, clock)
    return parts.read(folder, name, options)


def test_parts_of_monte_carlo_add_their_counts_up(tmp_path):
    found = finished(tmp_path, "mc", MC, 3)
    failures = sum(part["failures"] for part in found)
    assert failures > 0
    one = intervals.clopper_pearson(failures, 120, 0.95)
    assert parts.pool(found) == (failures / 120, one, [])


def test_runs_stand_beside_each_other(tmp_path):
    found = finished(tmp_path, "ess", ESS, 4)
    values = [part["probability"] for part in found]
    assert len(set(values)) > 1
    mean, (low, high), warnings = parts.pool(found)
    assert mean == pytest.approx(np.mean(values))
    assert low < min(mean, np.median(values)) < high
    assert "single_run" not in warnings
    with_zero = [*found, found[0] | {"run_probabilities": [0.0]}]
    assert parts.pool(with_zero)[0] == pytest.approx(0.8 * mean)
    mostly_zero = [*found, *[found[0] | {"run_probabilities": [0.0]}] * 5]
    assert "few_roots" in parts.pool(mostly_zero)[2]
    assert "single_run" in parts.pool(found[:1])[2]


def test_a_later_call_adds_only_the_missing_parts(tmp_path):
    first = finished(tmp_path, "mc", MC, 2)
    more = finished(tmp_path, "mc", MC, 3)
    assert more[:2] == first
    assert [part["seed"] for part in more] == [0, 1, 2]
    assert len({part["worst_robustness"] for part in more}) == 3
    with np.load(tmp_path / "mc-2.npz") as kept:
        assert len(kept["noise"]) == more[2]["failures"] == len(kept["ancestors"])
    with pytest.raises(ValueError, match="other options"):
        parts.read(tmp_path, "mc", MC | {"rollouts": 41})
    with pytest.raises(ValueError, match="other options"):
        parts.read(tmp_path, "mc", MC | {"scenario": "b"})


def test_parts_made_elsewhere_leave_the_gaps_between_them(tmp_path):
    whole = finished(tmp_path / "whole", "mc", MC, 3)
    (tmp_path / "some").mkdir()
    lines = (tmp_path / "whole" / "mc.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "some" / "mc.jsonl").write_text(lines[0] + lines[2])
    found = finished(tmp_path / "some", "mc", MC, 3)
    assert [part["seed"] for part in found] == [0, 2, 1]
    assert parts.pool(found) == parts.pool(whole)


def test_an_interrupted_part_goes_on_and_keeps_its_cpu_time(tmp_path):
    problem = linear(1.5, dim=5).problem(chunk=10)
    whole = finished(tmp_path / "whole", "mc", MC, 1, problem)
    times = [0.0, 60.0, 120.0]

    def clock():
        if not times:
            raise InterruptedError
        return times.pop(0)

    with pytest.raises(InterruptedError):
        parts.run(problem, "mc", MC, 1, tmp_path / "cut", clock)
    again = finished(tmp_path / "cut", "mc", MC, 1, problem)
    timed = ("cpu", "seconds")
    assert [part | dict.fromkeys(timed) for part in again] == [part | dict.fromkeys(timed) for part in whole]
    assert again[0]["cpu"] > 120.0
    assert not list((tmp_path / "cut").glob("*.cpu"))


def test_the_table_has_the_cost_of_all_parts(tmp_path):
    found = finished(tmp_path, "mc", MC, 3)
    rows = parts.table(tmp_path, {"mc": MC, "ess": ESS}).splitlines()[2:]
    assert len(rows) == 1
    assert "| `mc` | rollouts 40 | 3 |" in rows[0]
    assert "| 120 |" in rows[0]
    assert all(part["cpu"] >= 60.0 for part in found)  # a minute between two looks at the clock
    assert f"| {sum(part['cpu'] for part in found) / 60:.1f} min |" in rows[0]


def test_the_score_reads_delay_and_speed_and_is_0_where_a_failure_begins():
    usual = np.linspace(0.0, 200.0, 201)
    usual[-2:] += 10.0  # the reward of the arrival, which is no pace

    def at(t, reward, speed, crashed=0.0):
        one = {"speed": speed, "reward": reward, "crashed": crashed}
        signals = {name: np.full((1, t + 1), value) for name, value in one.items()}
        return float(danger(usual)(signals, t)[0])

    assert at(100, 100.0, 12.0) == pytest.approx(-1.0)
    assert -1.0 < at(100, 97.0, 12.0) < at(100, 95.0, 12.0) < 0.0
    assert at(200, LEAST_REWARD, 12.0) == pytest.approx(0.0, abs=0.05)
    assert at(200, LEAST_REWARD - 1.0, 12.0) > 0.0
    assert at(100, 100.0, LEAST_SPEED) == pytest.approx(0.0)
    assert at(20, 20.0, 0.0) == pytest.approx(-1.0)  # it starts from rest
    assert at(100, 100.0, 12.0, crashed=1.0) == 0.0
