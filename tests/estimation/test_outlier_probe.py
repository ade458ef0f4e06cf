"""Failures that one extreme noise number decides are found where an estimate has missed them."""

from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare.estimation.checks.outlier_probe import probe_outliers
from avrare.estimation.checks.pair_probe import pair_probe_cost, probe_pairs
from avrare.testing import faulty_systems as systems

STEPS = 8
START, LATER = 3.2, 3.6
RARE = NormalDist().cdf(-START)


class Starts:
    """A walk that begins beyond its bound where number 1 of the start is above ``START``."""

    noise_size = 3
    noise_names = ("push", "place", "idle")

    def initial(self, noise):
        return np.where(noise[:, 1] > START, 9.0, 0.0)

    def step(self, state, noise):
        return state + noise[:, 0] / STEPS**0.5

    def signals(self, state):
        return {"x": state}


class Walk(Starts):
    """The same without such starts."""

    def initial(self, noise):
        return np.zeros(len(noise))


class Jumps(Walk):
    """A walk that jumps where number 2 of a later step is below ``-LATER``."""

    def step(self, state, noise):
        return super().step(state, noise) + 9.0 * (noise[:, 2] < -LATER)


class Fragile(Starts):
    """A walk that breaks down at the rare start."""

    def initial(self, noise):
        return np.where(noise[:, 1] > START, np.nan, 0.0)


def problem(system, bound=6.0):
    return avrare.Problem(system(), avrare.stl(f"always (x < {bound})"), STEPS)


def found(case, upper, seed=0):
    return probe_outliers(case, 0, upper, seed, 0.95)


def test_a_rare_start_is_found_and_named():
    outliers = [found(problem(Starts), RARE / 4.0, seed) for seed in range(20)]
    assert {(one.noise, one.step) for one in outliers} == {("place", 0)}
    assert sum(RARE / 4.0 < one.low < RARE for one in outliers) >= 18  # each with probability .975


def test_an_outlier_of_any_later_step_is_found():
    rare = STEPS * NormalDist().cdf(-LATER)
    outliers = [found(problem(Jumps), rare / 4.0, seed) for seed in range(20)]
    assert {(one.noise, one.step) for one in outliers} == {("idle", None)}
    assert sum(rare / 4.0 < one.low < rare for one in outliers) >= 18


def test_what_an_estimate_knows_is_no_doubt():
    for seed in range(20):
        assert found(problem(Starts), 1.5 * RARE, seed) is None
        assert found(problem(Jumps), 1.5 * STEPS * NormalDist().cdf(-LATER), seed) is None


def test_failures_of_many_numbers_together_are_no_outliers():
    walk = problem(Walk, bound=4.0)
    for seed in range(20):
        assert found(walk, NormalDist().cdf(-4.0), seed) is None  # less than the walk's end alone


def test_a_rollout_that_breaks_down_has_not_failed():
    assert found(problem(Fragile), RARE / 4.0) is None


def split(seed, runs=40, **options):
    case = problem(Starts, bound=4.5)
    return avrare.estimate(case, "ams", seed=seed, runs=runs, particles=20, discard=2, grow=False, **options)


def test_an_estimate_that_missed_a_start_is_warned_of():
    results = [split(seed) for seed in range(6)]
    missed = [result for result in results if result.probability < RARE / 4.0]
    assert len(missed) >= 2
    assert all("outliers" in result.health for result in missed)
    seed = results.index(missed[0])
    assert "outliers" not in split(seed, suppress=("outliers",)).health


class Coins:
    """A walk that also fails where two numbers of the start, or of the first step, lie in opposite tails."""

    def __init__(self, step, noise_size=5, threshold=2.3):
        self.at, self.noise_size, self.threshold = step, noise_size, threshold
        self.noise_names = ("push", "rain", "idle", "dirt", *map(str, range(noise_size - 4)))

    def _fallen(self, noise):
        return (noise[:, 1] > self.threshold) & (noise[:, 3] < -self.threshold)

    def initial(self, noise):
        fallen = self._fallen(noise) & (self.at == 0)
        return {"x": np.where(fallen, 9.0, 0.0), "t": np.zeros(len(noise))}

    def step(self, state, noise):
        fallen = self._fallen(noise) & (self.at == 1) & (state["t"] == 0)
        return {"x": state["x"] + noise[:, 0] / STEPS**0.5 + 9.0 * fallen, "t": state["t"] + 1}

    def signals(self, state):
        return {"x": state["x"]}


BOTH = NormalDist().cdf(-2.3) ** 2


def found_pair(system, upper, seed=0):
    return probe_pairs(avrare.Problem(system, avrare.stl("always (x < 6)"), STEPS), 0, upper, seed, 0.95)


@pytest.mark.parametrize("step", [0, 1])
def test_two_numbers_that_fail_together_are_found_and_named(step):
    pairs = [found_pair(Coins(step), BOTH / 3.0, seed) for seed in range(10)]
    known = [one for one in pairs if one is not None]
    assert len(known) >= 6
    assert {(one.noise, one.step) for one in known} == {("rain` and `dirt", step)}
    assert all(BOTH / 3.0 < one.low < 1.2 * BOTH for one in known)
    assert sum(one.low < BOTH for one in known) >= len(known) - 1
    assert found(avrare.Problem(Coins(step), avrare.stl("always (x < 6)"), STEPS), BOTH / 3.0) is None


def test_pairs_that_an_estimate_knows_or_that_do_not_fail_are_no_doubt():
    for seed in range(20):
        assert found_pair(Coins(0), 1.5 * BOTH, seed) is None
        assert found_pair(Coins(0, threshold=9.0), BOTH / 3.0, seed) is None
    assert found_pair(systems.Walk(), 1e-5) is None


@pytest.mark.parametrize("size", [4, 6, 40])
@pytest.mark.parametrize("threshold", [-9.0, 2.3, 9.0])
def test_a_look_at_pairs_takes_no_more_rollouts_than_it_says(size, threshold):
    counting = systems.Counting(Coins(0, size, threshold))
    found_pair(counting, 1e-3)
    most = pair_probe_cost(avrare.Problem(Coins(0, size), avrare.stl("always (x < 6)"), STEPS))
    assert 24 * STEPS <= counting.rows <= most * STEPS


def test_an_estimate_that_missed_two_coins_is_warned_of():
    task = avrare.Problem(Coins(0, 4), avrare.stl("always (x < 4.5)"), STEPS)
    options = {"runs": 100, "particles": 50, "grow": False}
    results = [avrare.estimate(task, "ams", seed=seed, **options) for seed in range(3)]
    missed = [result for result in results if result.probability < BOTH / 2.0]
    assert missed
    assert all("numbers of `rain` and `dirt`" in result.health["outliers"] for result in missed)
