"""Reweighed trials: failures of one run tell of nearby values, where these have exact answers."""

import math
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.base.special_functions import normal_factor
from avrare.estimation.result.intervals import weighted_counts
from avrare.stack.closed_loop import ClosedLoop
from avrare.testing.faulty_systems import Walk
from avrare_design.require import _reweighable
from avrare_design.reweighed_trial import HALVING, Reweigher, _estimate
from noisy_loop import STEPS, Adder, Gain, Last, Sensor, exact, noisy_problem


def test_failures_of_one_run_tell_of_values_nearby():
    # Of some 180 failures 100 are kept.
    result = avrare.estimate(noisy_problem(1.0), "mc", rollouts=8_000, seed=4)
    reweigher = Reweigher(noisy_problem(1.0), 1.0, Sensor)
    # At 4.0 too few effective failures are left.
    own, near, lower = reweigher.reweigh(result, (1.0, 1.1, 0.9, 4.0), 0.95)
    assert own.probability == pytest.approx(result.probability)
    assert own.interval == pytest.approx(result.interval, rel=0.01)
    for one in (near, lower):
        low, high = one.interval
        assert low < exact(one.value).p < high < 1.6 * low
    # Log weights spread by the score's standard deviation times the distance.
    score = reweigher.score(result.failures)
    reach = score.reach
    assert score.error == pytest.approx(HALVING / reach / math.sqrt(len(result.failures.noise)))
    weights = np.exp(reweigher._ratios(result.failures, (1.0 + 0.5 * reach,))[:, 0])
    effective = weights.sum() ** 2 / (weights**2).sum() / len(weights)
    assert -math.log(effective) == pytest.approx((0.5 * HALVING) ** 2, rel=0.3)


def test_the_interval_of_what_is_reweighed_is_that_of_weighted_counts():
    result = replace(avrare.estimate(noisy_problem(1.0), "mc", rollouts=4_000, seed=4), errors=3)
    count = result.failures.count
    assert count == len(result.failures.noise)
    weights = np.exp(np.random.default_rng(0).normal(0.0, 0.8, count))
    found = _estimate(1.2, weights, result, 0.9)
    assert found.probability == pytest.approx(weights.sum() / 4_000)
    errors = np.full(3, weights.max() / 4_000)
    expected = weighted_counts(weights / 4_000, 4_000, weights.max() / 4_000, 0.9, errors)
    assert found.interval == pytest.approx(expected, rel=5e-3)
    # Of ten times as many failures as were kept the mean weight is known as well as before.
    more = replace(result, failures=replace(result.failures, count=10 * count), trials=40_000, errors=0)
    high = math.log(_estimate(1.2, weights, more, 0.9).interval[1] / found.probability)
    spread = 1.0 / (10 * count) + weights.var() / (count * weights.mean() ** 2)
    assert high == pytest.approx(normal_factor(0.9) * math.sqrt(spread), rel=0.15)


def test_rollouts_of_the_choice_are_no_trials_of_what_is_reweighed():
    result = avrare.estimate(noisy_problem(1.0), "auto", budget="rollouts=8000", seed=4)
    assert result.estimator == "mc"
    assert 0 < result.trials < result.rollouts
    (own,) = Reweigher(noisy_problem(1.0), 1.0, Sensor).reweigh(result, (1.0,), 0.95)
    assert own.probability == pytest.approx(result.probability)
    assert own.interval == pytest.approx(result.interval, rel=0.01)


def test_only_parameters_of_the_perception_are_reweighed_for():
    problem, other = noisy_problem(1.0), avrare.Problem(Walk(), avrare.stl("always (x < 1)"), steps=5)
    result = avrare.estimate(problem, "mc", rollouts=3_000, seed=4)
    assert _reweighable(problem, "perception.sd", result)
    assert not _reweighable(problem, "controller.gain", result)  # failures weigh 1 at all of its values
    assert not _reweighable(other, "perception.sd", avrare.estimate(other, "mc", rollouts=300))


def test_no_value_outside_the_ends_is_built():
    result = avrare.estimate(noisy_problem(1.0), "mc", rollouts=3_000, seed=4)
    tried = []

    def build(value):
        tried.append(value)
        return Sensor(value)

    free = Reweigher(noisy_problem(1.0), 1.0, Sensor).score(result.failures)
    score = Reweigher(noisy_problem(1.0), 1.0, build, (0.2, 1.0)).score(result.failures)
    assert max(tried) == 1.0
    assert score.slope == pytest.approx(free.slope, rel=0.01)


def test_failures_without_a_density_ratio_tell_nothing_of_other_values(monkeypatch):
    def refuse(*arguments):
        raise UsageError("no density ratio is known for this number", "vary another")

    monkeypatch.setattr(Sensor, "log_ratio", refuse)
    result = avrare.estimate(noisy_problem(1.0), "mc", rollouts=3_000, seed=4)
    reweigher = Reweigher(noisy_problem(1.0), 1.0, Sensor)
    assert result.failures.count > 20
    assert reweigher.score(result.failures) is None
    assert reweigher.reweigh(result, (0.9, 1.1), 0.95) == ()


class Bounded(Sensor):
    """Sensor whose errors end at a bound, which is the parameter."""

    def log_ratio(self, world, noise, memory, other, other_memory):
        ends = np.where(np.abs(noise[:, 0]) > other.sd, -np.inf, 0.0)
        return ends + (np.nan if other.sd > self.sd else 0.0), None


def test_values_at_which_more_can_happen_are_left_to_runs_of_their_own():
    result = avrare.estimate(noisy_problem(1.0), "mc", rollouts=4_000, seed=4)
    loop = ClosedLoop(Adder(), Bounded(3.0), Last(), Gain())
    problem = avrare.Problem(loop, avrare.stl("always (x < 4)"), steps=STEPS)
    reweigher = Reweigher(problem, 3.0, Bounded)
    assert [one.value for one in reweigher.reweigh(result, (2.9, 3.0, 3.1), 0.95)] == [2.9, 3.0]
    assert reweigher.score(result.failures) is None
