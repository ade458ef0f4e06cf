"""Budgets of seconds, by a clock that the simulated system itself moves on."""

import itertools

import numpy as np
import pytest

import avrare
from avrare.base.errors import Interrupted
from avrare.estimation.loop import loop
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import Pace, run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import faulty_systems as systems

STEPS = 10


class Clocked(systems.Walk):
    """Walk that takes ``batch`` seconds for a rollout of a batch, and ``row`` seconds more for each row."""

    def __init__(self, clock, batch, row):
        super().__init__()
        self.clock, self.batch, self.row = clock, batch, row

    def step(self, state, noise):
        self.clock[0] += (self.batch + self.row * len(noise)) / STEPS
        return super().step(state, noise)


@pytest.fixture
def estimate(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(loop.time, "perf_counter", lambda: clock[0])

    def run_for(seconds, batch, row, journal=None, stop=None):
        formula, settings = avrare.stl("always (x < 0.5)"), Settings(budget=Budget("seconds", seconds))
        problem = avrare.Problem(Clocked(clock, batch, row), formula, steps=STEPS, chunk=200)
        return run(problem, MonteCarlo(McConfig()), SerialExecutor(), settings, None, journal, stop)[0]

    return run_for


def of_the_first(rollouts):
    problem = avrare.Problem(systems.Walk(), avrare.stl("always (x < 0.5)"), steps=STEPS)
    return avrare.estimate(problem, rollouts=rollouts)


@pytest.mark.parametrize(
    ("seconds", "batch", "row"),
    [
        (0.5, 0.0, 3.0),
        (10.0, 0.0, 3.0),
        (10.0, 0.0, 0.7),
        (10.0, 0.0, 0.01),
        (10.0, 0.4, 0.001),
        (5.0, 0.6, 0.2),
    ],
)
def test_a_budget_is_kept_within_a_fifth_or_one_rollout(estimate, seconds, batch, row):
    result = estimate(seconds, batch, row)
    assert result.seconds <= max(1.2 * seconds, seconds + batch + row)
    assert len(result.run_probabilities) == 1
    assert result.rollouts == 1 or result.seconds >= 0.6 * seconds
    np.testing.assert_array_equal(result.robustness, of_the_first(result.rollouts).robustness)


@pytest.mark.parametrize("chunks", [1, 3, 5])
def test_pieces_of_chunks_are_resumed(estimate, tmp_path, chunks):
    looks = iter([False] * chunks + [True] * 99)
    with pytest.raises(Interrupted):
        estimate(10.0, 0.4, 0.02, Checkpoint.open(tmp_path, {}).journal("it"), lambda: next(looks))
    saved = Checkpoint.open(tmp_path, {})
    assert saved.chunks == chunks
    result = estimate(10.0, 0.4, 0.02, saved.journal("it"))
    assert 6.0 <= result.seconds <= 12.0
    np.testing.assert_array_equal(result.robustness, of_the_first(result.rollouts).robustness)
    again = estimate(10.0, 0.4, 0.02, saved.journal("it"))  # killed before it wrote its result
    assert again.rollouts >= result.rollouts
    np.testing.assert_array_equal(again.robustness, of_the_first(again.rollouts).robustness)


def test_the_first_rollout_runs_however_little_time_there_is(monkeypatch):
    monkeypatch.setattr(loop.time, "perf_counter", itertools.count().__next__)  # a second between two looks
    problem = avrare.Problem(systems.Walk(), avrare.stl("always (x < 0.5)"), steps=STEPS)
    settings = Settings(budget=Budget("seconds", 0.5))
    assert run(problem, MonteCarlo(McConfig()), SerialExecutor(), settings)[0].rollouts == 1


def test_outcomes_that_arrive_at_once_do_not_look_fast():
    """Take two workers that start in five seconds and then need one for a row."""
    pace = Pace()
    assert [pace.take(0.0, 10.0, 100) for _ in range(4)] == [1, 1, 1, 1]
    for _ in range(2):
        pace.finish(1)
    assert pace.take(6.0, 4.0, 100) == 0
    for _ in range(2):
        pace.finish(1)
    assert pace.take(7.0, 3.0, 100) == 1
