"""The interval over an ensemble of models: it covers, the shares are right, and rollouts are used again."""

import math
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.base.special_functions import chi_square_quantiles, t_factor
from avrare.estimation.combine.ensemble import ModelShare, combine, reweigh
from avrare.rollout.weighted_problem import log_ratios
from avrare.testing.repeated_estimates import coverage_at_most
from noisy_loop import Sensor, exact, noisy_problem

pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")


def share(logs, covariance):
    return ModelShare(np.exp(logs), logs, covariance, 0, float(np.exp(logs.mean())))


def test_chi_square_quantiles():
    found = chi_square_quantiles(4, 2)
    assert found == pytest.approx(-2.0 * np.log1p(-np.array([0.125, 0.375, 0.625, 0.875])), rel=1e-9)


def test_exact_members_give_the_prediction_interval():
    logs = np.log([1e-3, 2e-3, 1.5e-3, 0.8e-3, 1.2e-3, 1.1e-3])
    low, high = share(logs, np.zeros((6, 6))).interval(0.95)
    half = t_factor(0.95, 5) * math.sqrt(logs.var(ddof=1) * (1.0 + 1.0 / 6.0))
    assert math.log(low) == pytest.approx(logs.mean() - half, rel=0.01)
    assert math.log(high) == pytest.approx(logs.mean() + half, rel=0.01)
    assert share(logs, np.zeros((6, 6))).share == 1.0


def test_one_model_leaves_the_sampling_error():
    logs = np.full(8, math.log(1e-3))
    alone = share(logs, np.full((8, 8), 0.01))
    low, high = alone.interval(0.95)
    assert (math.log(high / 1e-3), math.log(1e-3 / low)) == pytest.approx((0.196, 0.196), rel=1e-3)
    assert alone.share == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("size", "model", "sampling", "common"), [(6, 0.3, 0.1, 0.0), (10, 0.2, 0.2, 0.19)])
def test_covers_what_is_drawn_from_the_same_law(size, model, sampling, common):
    rng, trials, covered, shares = np.random.default_rng(1), 200, 0, []
    covariance = np.full((size, size), common**2) + np.eye(size) * (sampling**2 - common**2)
    for _ in range(trials):
        errors = rng.multivariate_normal(np.zeros(size), covariance)
        found = share(-7.0 + model * rng.standard_normal(size) + errors, covariance)
        low, high = found.interval(0.95)
        covered += low <= math.exp(-7.0 + model * rng.standard_normal()) <= high
        shares.append(found.share)
    assert coverage_at_most(covered, trials, 0.95) > 1e-3
    own = model**2 * (1.0 + 1.0 / size)
    assert np.mean(shares) == pytest.approx(own / (own + covariance.sum() / size**2), abs=0.12)


def estimate(sds, seed, rollouts=3000):
    base = avrare.estimate(noisy_problem(), "mc", rollouts=rollouts, seed=seed)
    problem = noisy_problem()
    known = reweigh(base, log_ratios(problem, [Sensor(sd) for sd in sds], base.failures.noise))
    fresh = {
        k: avrare.estimate(noisy_problem(sd), "mc", rollouts=rollouts, seed=1000 * seed + k + 1)
        for k, sd in enumerate(sds)
        if math.isnan(known.probabilities[k])
    }
    return base, known, combine(base, len(sds), known, fresh)


def test_rollouts_are_reweighed_where_enough_of_them_are_left():
    sds = [0.93, 0.97, 1.0, 1.03, 0.3]
    base, known, result = estimate(sds, 3)
    assert np.isnan(known.probabilities).tolist() == [False, False, False, False, True]
    assert known.probabilities[2] == pytest.approx(base.probability)
    model = result.diagnostics["model"]
    assert model["reweighed"] == 4
    assert result.rollouts == 2 * base.rollouts
    assert result.probability == pytest.approx(np.mean(model["members"]))
    for sd, value in zip(sds[:2], model["members"], strict=False):
        assert value / base.probability == pytest.approx(exact(sd).p / exact().p, rel=0.15)
    assert result.interval[0] <= result.probability <= result.interval[1]
    assert "4 by reweighing, 1 run anew" in {note.kind: note.text for note in result.notes}["model"]


def test_few_kept_failures_leave_the_error_of_all():
    base = avrare.estimate(noisy_problem(), "mc", rollouts=40_000, seed=5)
    assert base.failures.count > 5 * len(base.failures.noise)
    known = reweigh(base, np.zeros((len(base.failures.noise), 4)))
    result = combine(base, 4, known, {})
    assert result.diagnostics["model"]["sampling_variance"] == pytest.approx(base.relative_error**2)
    assert result.diagnostics["model"]["model_share"] == 0.0
    assert result.interval == pytest.approx(base.interval, rel=0.02)


def test_a_wider_model_moves_the_shares():
    _, _, narrow = estimate([0.99, 0.995, 1.0, 1.005, 1.01], 4)
    _, _, wide = estimate([0.8, 0.9, 1.0, 1.1, 1.2], 4)
    assert narrow.diagnostics["model"]["model_share"] < 0.3 < wide.diagnostics["model"]["model_share"]
    sampling = narrow.interval[1] / narrow.interval[0]
    assert wide.interval[1] / wide.interval[0] > 1.5 * sampling


def test_a_model_without_failures_is_told():
    base = avrare.estimate(noisy_problem(), "mc", rollouts=500, seed=1)
    empty = avrare.estimate(noisy_problem(0.05), "mc", rollouts=500, seed=2)
    result = combine(base, 3, None, {0: base, 1: replace(base, rollouts=500), 2: empty})
    assert "model_unknown" in result.health
    assert result.interval[1] >= base.interval[1]


@pytest.mark.slow
def test_covers_the_probability_under_a_model_from_a_known_prior():
    rng, trials, covered = np.random.default_rng(5), 150, 0
    for seed in range(trials):
        sds = np.exp(0.05 * rng.standard_normal(8))
        _, _, result = estimate(sds.tolist(), seed, rollouts=2000)
        low, high = result.interval
        covered += low <= exact(float(np.exp(0.05 * rng.standard_normal()))).p <= high
    assert coverage_at_most(covered, trials, 0.95) > 1e-3
