"""Leaps: failures that one outlier decides are told apart from those that splitting can climb to."""

import numpy as np
import pytest

import avrare
from avrare.testing.problems import reference_problem
from avrare_estimators.ams.leaps import Leaps

STEPS = 10


class Outlier:
    """A system whose signal is the largest number so far: every step begins anew."""

    noise_size = 1

    def initial(self, noise):
        return np.zeros(len(noise))

    def step(self, state, noise):
        return np.maximum(state, noise[:, 0])

    def signals(self, state):
        return {"x": state}


def test_leaps_are_counted():
    # 1,000 rollouts; 10 pass the level of 1 %, of which the last 4 came there by way of more than 10 %.
    scores = np.repeat(np.arange(1000.0)[:, None], 3, axis=1)
    scores[990:996, :2] = 500.0
    scores[996:, :2] = 950.0
    assert Leaps.of(scores) == Leaps(6, 10)


def test_a_high_start_is_no_leap():
    assert Leaps.of(np.repeat(np.arange(1000.0)[:, None], 3, axis=1)).count == 0


def test_few_rows_are_not_judged():
    assert not Leaps(15, 19).too_many
    assert Leaps(15, 20).too_many
    assert (Leaps(15, 19) + Leaps(0, 1)).too_many
    assert not (Leaps(15, 20) + Leaps(0, 40)).too_many


def test_none_where_every_rollout_breaks_down():
    assert Leaps.of(np.empty((0, 4))) == Leaps()


@pytest.mark.parametrize("seed", range(3))
def test_splitting_warns_of_what_it_cannot_climb_to(seed):
    problem = avrare.Problem(Outlier(), avrare.stl("always (x < 4)"), STEPS)
    assert "leaps" in avrare.estimate(problem, "ams", seed=seed, runs=20, particles=100, discard=10).health


@pytest.mark.parametrize("name", ["d_rw_L3.8", "e_ou_L4.0"])
def test_what_can_be_climbed_to_is_not_warned_of(name):
    problem = reference_problem(name).problem()
    for seed in range(3):
        result = avrare.estimate(problem, "ams", seed=seed, runs=25, particles=100, discard=10)
        assert "leaps" not in result.health


def test_warnings_do_not_depend_on_batches_of_runs():
    problem = avrare.Problem(Outlier(), avrare.stl("always (x < 4)"), STEPS)
    options = {"runs": 40, "particles": 200, "discard": 20, "grow": False}
    whole = avrare.estimate(problem, "ams", seed=1, **options)
    parts = avrare.estimate(problem, "ams", seed=1, memory=1, **options)
    assert "leaps" in whole.health
    assert "leaps" in parts.health
