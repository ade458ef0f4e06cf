"""Importance sampling against exact answers, and what it says where it breaks."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.testing.problems import reference_problem

sys.path.insert(0, str(Path(__file__).parent))  # workers must find it too
import toy_closed_loop as toy

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


def deviation(values, truth):
    values = np.asarray(values)
    return abs(values.mean() - truth) / (values.std(ddof=1) / np.sqrt(len(values)))


@pytest.mark.slow
@pytest.mark.parametrize("defensive", [0.0, 0.1, 0.5])
def test_unbiased_over_two_hundred_seeds(defensive):
    task = LINE.problem()
    results = [
        estimate(task, exact_shift(), seed, rollouts=300, defensive=defensive, check=0.0)
        for seed in range(200)
    ]
    values = np.array([result.probability for result in results])
    assert deviation(values, LINE.probability) < 4
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
    one = estimate(LINE.problem(), {"name": "gaussian", "mean": SHIFT})
    assert abs(one.probability - LINE.probability) < 4 * one.relative_error * one.probability
    assert one.relative_error < 0.2


def test_failures_replay_bit_for_bit():
    task = LINE.problem()
    result = estimate(task, exact_shift())
    assert 0 < len(result.failures.robustness) <= 100
    np.testing.assert_array_equal(task.robustness(result.failures.noise), result.failures.robustness)
    assert task.robustness(result.worst.noise[None])[0] == result.worst.robustness
    assert result.worst.robustness <= result.failures.robustness.min()


@pytest.mark.slow
def test_same_bits_for_two_workers_and_any_chunk_boundaries():
    task = avrare.Problem(toy.Coin(), avrare.stl("always (x < 6)"), 9, chunk=50)
    proposal = {"name": "gaussian", "mean": 0.8}
    one, two = (
        avrare.estimate(task, "is", proposal=proposal, rollouts=430, runs=2, workers=w) for w in (1, 2)
    )
    drop = {"seconds"}
    assert {k: v for k, v in one.to_dict().items() if k not in drop} == {
        k: v for k, v in two.to_dict().items() if k not in drop
    }
    np.testing.assert_array_equal(one.failures.noise, two.failures.noise)


def test_runs_are_the_same_for_any_number_of_them():
    task = LINE.problem()
    three = estimate(task, exact_shift(), runs=3)
    assert three.run_probabilities[0] == estimate(task, exact_shift()).probability
    values = three.run_probabilities
    assert len(set(values)) == 3
    assert three.probability == pytest.approx(values.mean())
    assert three.relative_error == pytest.approx(values.std(ddof=1) / np.sqrt(3) / values.mean())


def test_cost_is_counted():
    task = LINE.problem()
    assert estimate(task, exact_shift(), check=0.0).rollouts == 1000
    assert 750 <= estimate(task, exact_shift()).rollouts <= 1000
    small = avrare.estimate(task, "is", proposal=exact_shift(), runs=2, budget="rollouts=500", check=0.0)
    assert small.rollouts == 500


# Where it breaks


@pytest.mark.parametrize("proposal", [exact_shift(-1.0), {"name": "gaussian", "mean": 0.0}])
def test_no_failures(proposal):
    result = estimate(LINE.problem(), proposal)
    assert result.probability == 0.0
    low, high = result.interval
    assert low == 0.0
    assert high == pytest.approx(1 - 0.025 ** (1 / result.diagnostics["target_rows"][0]))
    assert "no_failures" in result.health
    bare = estimate(LINE.problem(), proposal, defensive=0.0)
    assert bare.interval == (0.0, 1.0)
    assert json.loads(result.to_json())["relative_error"] is None


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


def test_errors_raise_the_upper_bound():
    task = avrare.Problem(toy.Coin(breaks=0.5), avrare.stl("always (x < 6)"), 9)
    healthy = avrare.Problem(toy.Coin(), avrare.stl("always (x < 6)"), 9)
    broken, sound = (estimate(t, {"name": "gaussian", "mean": 0.3}, rollouts=4000) for t in (task, healthy))
    assert broken.errors > 0.3 * broken.rollouts
    assert "errors" in broken.health
    assert broken.interval[1] > 0.3
    assert broken.probability < 0.8 * sound.probability


# A perception model as proposal

LIMIT = 7.0
NEAR = toy.Pem(toy.scene(), 0.85, 0.8, 1.2)


@pytest.mark.parametrize("defensive", [0.0, 0.1])
def test_perception_weights_are_right(defensive):
    task, truth = toy.final_only(LIMIT), toy.exact(LIMIT)
    result = estimate(task, NEAR, rollouts=800, runs=30, defensive=defensive, check=0.0)
    assert deviation(result.run_probabilities, truth) < 4
    assert result.relative_error < 0.15
    marks = result.diagnostics
    assert abs(marks["mean_weight"] - 1) < 4 * marks["mean_weight_error"]
    assert marks["mean_weight_error"] < 0.1


def test_the_target_as_its_own_proposal_has_weight_one():
    result = estimate(toy.final_only(4.0), toy.Pem(toy.scene()), check=0.0)
    assert result.diagnostics["mean_weight"] == pytest.approx(1.0, abs=1e-12)
    assert result.probability == pytest.approx(result.failures.count / 1000)


def test_perception_rows_do_not_depend_on_their_neighbours():
    from avrare.rollout.noise import NoiseSource
    from avrare.rollout.request import FROM_START, Request
    from avrare.rollout.weighted_problem import WeightedProblem
    from avrare.stack.closed_loop import SamplingLaw

    task = WeightedProblem(toy.final_only(LIMIT), NEAR)
    same = np.ones(40, dtype=np.int64)
    request = Request(0 * same, 0 * same, np.arange(40), FROM_START * same, law=SamplingLaw())
    noise = NoiseSource(1, task.noise_size)
    whole = task.simulate(noise, request)
    assert len(set(whole.log_weight)) == 40
    for begin, end in ((0, 1), (7, 29)):
        part = task.simulate(noise, request.slice(begin, end))
        assert part.log_weight.tobytes() == whole.log_weight[begin:end].tobytes()
        assert part.robustness.tobytes() == whole.robustness[begin:end].tobytes()


def test_perception_failures_replay_under_the_target():
    task = toy.final_only(1.0)
    result = estimate(task, NEAR)
    assert result.failures.count > len(result.failures.robustness) > 0
    np.testing.assert_array_equal(task.robustness(result.failures.noise), result.failures.robustness)


@pytest.mark.slow
def test_perception_same_bits_for_two_workers():
    task = toy.final_only(LIMIT, chunk=64)
    one, two = (avrare.estimate(task, "is", proposal=NEAR, rollouts=300, workers=w) for w in (1, 2))
    assert one.to_dict() | {"seconds": 0} == two.to_dict() | {"seconds": 0}


def test_an_unsuitable_model_gives_a_warning():
    result = estimate(toy.final_only(LIMIT), toy.Pem(toy.scene(), 0.5, 3.0, 3.0), rollouts=300)
    assert result.health
    low, high = result.interval
    assert low <= toy.exact(LIMIT) <= high


# Misuse


def test_misuse_is_a_clear_error():
    task = LINE.problem()
    for wrong in (3, "naive", {}, {"name": "gaussian", "sigma": 1}, {"name": "gaussian", "mean": "x"}):
        with pytest.raises(avrare.UsageError):
            estimate(task, wrong)
    with pytest.raises(avrare.UsageError, match="mean does not fit"):
        estimate(task, {"name": "gaussian", "mean": [1.0, 2.0]})
    with pytest.raises(avrare.UsageError, match="finite and positive"):
        estimate(task, {"name": "gaussian", "std": 0.0})
    with pytest.raises(avrare.UsageError, match="log_ratio raised ValueError"):
        estimate(task, Shift(np.zeros((3, 2))))
    with pytest.raises(avrare.UsageError, match="has shape"):
        estimate(task, Shift(np.zeros((3, 2))), defensive=0.0)
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
