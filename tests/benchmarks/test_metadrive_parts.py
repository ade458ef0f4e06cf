"""Parts of an estimate are one estimate: counts add up, and runs stand beside each other. And a score."""

import itertools

import numpy as np
import pytest
from metadrive_study import LEAST_REWARD, LEAST_SPEED, danger
from studies import metadrive_parts as parts

from avrare.estimation.result import intervals
from avrare.testing.static_problems import linear

MC = {"rollouts": 40, "scenario": "a"}


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
