"""Failures that one extreme noise number decides are found where an estimate has missed them."""

from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare.estimation.outlier_probe import probe_cost, probe_outliers

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


@pytest.mark.parametrize("seed", range(5))
def test_a_rare_start_is_found_and_named(seed):
    outliers = found(problem(Starts), RARE / 4.0, seed)
    assert (outliers.noise, outliers.at_start) == ("place", True)
    assert RARE / 4.0 < outliers.low < RARE


@pytest.mark.parametrize("seed", range(5))
def test_an_outlier_of_any_later_step_is_found(seed):
    rare = STEPS * NormalDist().cdf(-LATER)
    outliers = found(problem(Jumps), rare / 4.0, seed)
    assert (outliers.noise, outliers.at_start) == ("idle", False)
    assert rare / 4.0 < outliers.low < rare


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


def test_no_bit_depends_on_the_chunk():
    case = problem(Starts)
    other = problem(Starts)
    other.chunk = 7
    assert found(case, RARE / 4.0) == found(other, RARE / 4.0)


def split(seed, runs=20, **options):
    case = problem(Starts, bound=4.5)
    return avrare.estimate(case, "ams", seed=seed, runs=runs, particles=20, discard=2, grow=False, **options)


def test_an_estimate_that_missed_a_start_is_warned_of():
    results = [split(seed) for seed in range(6)]
    missed = [result for result in results if result.interval[1] < RARE / 2.0]
    assert len(missed) >= 3
    assert all("outliers" in result.health for result in missed)
    seed = results.index(missed[0])
    assert "outliers" not in split(seed, suppress=("outliers",)).health


def test_small_estimates_are_not_probed():
    case = problem(Starts)
    assert probe_cost(case) == 5 * 12 + 96
    result = split(0, runs=2)
    assert result.rollouts < 20 * probe_cost(case)
    assert "outliers" not in result.health
