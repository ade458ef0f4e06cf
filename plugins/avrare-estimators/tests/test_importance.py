"""Importance sampling against exact answers, and what it says where it breaks."""

from types import SimpleNamespace

import numpy as np
import pytest

import avrare
import toy_closed_loop as toy
from avrare.testing.problems import reference_problem
from avrare.testing.repeated_estimates import deviation

LINE = reference_problem("b_linear_d100_p1e-4")
SHIFT = 0.37190164854556804


class Shift:
    """Noise around another mean."""

    def __init__(self, mean):
        self.mean = np.asarray(mean)

    def sample(self, rng, n):
        return self.mean + rng.standard_normal((n, *self.mean.shape))

    def log_ratio(self, noise):
        flat, mean = noise.reshape(len(noise), -1), self.mean.reshape(-1)
        return (0.5 * mean * mean - flat * mean).sum(axis=1)


def exact_shift(scale=1.0):
    return Shift(np.full((1, 100), scale * SHIFT))


def estimate(problem, proposal, seed=0, **options):
    return avrare.estimate(problem, "is", seed=seed, proposal=proposal, **{"rollouts": 1000, **options})


@pytest.mark.slow
@pytest.mark.parametrize("defensive", [0.0, 0.1, 0.5])
def test_unbiased_over_two_hundred_seeds(defensive):
    task = LINE.problem()
    results = [
        estimate(task, exact_shift(), seed, rollouts=300, defensive=defensive, check=0.0)
        for seed in range(200)
    ]
    values = np.array([result.probability for result in results])
    assert abs(deviation(values, LINE.probability)) < 4
    assert values.std() / np.sqrt(200) < 0.03 * LINE.probability
    covered = np.mean([low <= LINE.probability <= high for low, high in (r.interval for r in results)])
    assert covered > 0.95 - 4 * np.sqrt(0.05 * 0.95 / 200)


@pytest.mark.slow
def test_good_proposals_give_no_warning():
    task = LINE.problem()
    results = [estimate(task, exact_shift(), seed, rollouts=30_000) for seed in range(20)]
    assert np.mean([bool(result.health) for result in results]) <= 0.1
    widths = [result.interval[1] / result.interval[0] for result in results]
    assert np.median(widths) < 1.6


def test_gaussian_of_a_scenario_is_the_same_law():
    result = estimate(LINE.problem(), {"name": "gaussian", "mean": SHIFT})
    assert abs(result.probability - LINE.probability) < 4 * result.relative_error * result.probability
    assert result.relative_error < 0.2


# Where it breaks


def test_degenerate_weights_widen_the_interval():
    task = LINE.problem()
    wide = Shift(np.full((1, 100), SHIFT) + np.random.default_rng(0).standard_normal((1, 100)) * 0.5)
    results = [estimate(task, wide, seed) for seed in range(20)]
    assert all({"weight_degenerate", "no_failures"} & set(result.health) for result in results)
    for result in results:
        low, high = result.interval
        assert low <= LINE.probability <= high
        assert low == pytest.approx(0.025 * result.probability)
        rows = result.diagnostics["target_rows"][0]
        assert high >= (1.0 - 0.025 ** (1.0 / rows)) * (1.0 - 1e-9)


@pytest.mark.slow
def test_a_missed_mode_is_found_by_the_cross_check():
    """Take many design points: at one of them a proposal finds a fraction of the truth and looks well."""
    problem = reference_problem("e_ou_L5.0")
    tape = np.zeros((101, 1))
    reach = np.sqrt(0.19) * 0.9 ** np.arange(99, -1, -1)
    tape[1:, 0] = reach * 5.0 / (reach @ reach)
    results = [estimate(problem.problem(), Shift(tape), seed, rollouts=30_000) for seed in range(10)]
    off = [result for result in results if not 1 / 3 < result.probability / problem.probability < 3]
    assert len(off) >= 8
    assert sum(bool(result.health) for result in off) >= 0.9 * len(off)
    assert sum("contradicted" in result.health for result in off) > 0.2 * len(off)
    narrow = [result for result in off if result.interval[1] < problem.probability / 3]
    assert not [result for result in narrow if result.health]


def test_tiny_weights_give_a_warning():
    """Take weights far below the square root of the smallest number."""
    result = estimate(LINE.problem(), exact_shift(60.0), defensive=0.0, check=0.0)
    assert 0.0 <= result.probability < 1e-150
    assert {"weight_degenerate", "no_failures"} & set(result.health)
    assert result.interval[0] <= result.probability <= result.interval[1] == 1.0


def test_wrong_weights_are_detected():
    class Twice(Shift):
        def log_ratio(self, noise):
            return super().log_ratio(noise) + np.log(2.0)

    result = estimate(LINE.problem(), Twice(np.full((1, 100), 0.05)), defensive=0.0, check=0.0)
    assert "weight_degenerate" in result.health


# A perception model as proposal

LIMIT = 7.0
NEAR = toy.Pem(toy.scene(), 0.85, 0.8, 1.2)


@pytest.mark.parametrize("defensive", [0.0, 0.1])
def test_perception_weights_are_right(defensive):
    task, truth = toy.final_only(LIMIT), toy.exact(LIMIT)
    result = estimate(task, NEAR, rollouts=800, runs=30, defensive=defensive, check=0.0)
    assert abs(deviation(result.run_probabilities, truth)) < 4
    assert result.relative_error < 0.15
    marks = result.diagnostics
    assert abs(marks["mean_weight"] - 1) < 4 * marks["mean_weight_error"]
    assert marks["mean_weight_error"] < 0.1


def test_the_target_as_its_own_proposal_has_weight_one():
    result = estimate(toy.final_only(4.0), toy.Pem(toy.scene()), check=0.0)
    assert result.diagnostics["mean_weight"] == pytest.approx(1.0, abs=1e-12)
    assert result.probability == pytest.approx(result.failures.count / 1000)


def test_an_unsuitable_model_gives_a_warning():
    result = estimate(toy.final_only(LIMIT), toy.Pem(toy.scene(), 0.5, 3.0, 3.0), rollouts=300)
    assert result.health
    low, high = result.interval
    assert low <= toy.exact(LIMIT) <= high


# Misuse


def test_misuse_is_a_clear_error():
    task = LINE.problem()
    gaussian = {"name": "gaussian"}
    for wrong in (3, "naive", {}, {"gaussian": 1}, {"name": "normal"}, gaussian | {"sigma": 1}, object()):
        with pytest.raises(avrare.UsageError, match="proposal"):
            estimate(task, wrong)
    with pytest.raises(avrare.UsageError, match="mean does not fit"):
        estimate(task, gaussian | {"mean": [1.0, 2.0]})
    with pytest.raises(avrare.UsageError, match="finite and positive"):
        estimate(task, gaussian | {"std": 0.0})
    with pytest.raises(avrare.UsageError, match="has shape"):
        estimate(task, Shift(np.zeros((3, 2))))
    with pytest.raises(avrare.UsageError, match="log_ratio raised ValueError"):
        estimate(
            task, SimpleNamespace(sample=exact_shift().sample, log_ratio=Shift(np.zeros((3, 2))).log_ratio)
        )
    with pytest.raises(avrare.UsageError, match="needs a closed loop"):
        estimate(task, NEAR)
    with pytest.raises(avrare.UsageError, match="no_such"):
        estimate(task, {"plugin": "no_such"})
    with pytest.raises(avrare.UsageError, match="cannot be stopped by the clock"):
        avrare.estimate(task, "is", proposal=exact_shift(), budget="seconds=1")
    with pytest.raises(avrare.UsageError, match="does not pay"):
        avrare.estimate(task, "is", proposal=exact_shift(), budget="rollouts=1")


def test_a_target_without_density_is_refused():
    with pytest.raises(avrare.UsageError, match="no log_prob"):
        estimate(toy.final_only(LIMIT, perception=toy.Blind(toy.scene())), NEAR)
