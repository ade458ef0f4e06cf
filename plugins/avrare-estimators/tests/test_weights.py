"""Importance weights: definitions, bounds, and what they report of themselves."""

import numpy as np
import pytest

from avrare_estimators.common.tapes.gaussian_mixture import GaussianMixture
from avrare_estimators.common.weights import (
    anneal,
    effective_size,
    mixture_log_weights,
    quality,
    resample,
    stratified_variance,
)

LOGS = np.array([-800.0, -3.0, 0.0, 2.5, 800.0, np.inf, -np.inf])


def test_mixture_weights_are_p_over_the_mixture():
    ratio = np.exp(LOGS[1:4])
    np.testing.assert_allclose(np.exp(mixture_log_weights(LOGS[1:4], 0.2)), ratio / (0.2 * ratio + 0.8))


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 1.0])
def test_defensive_rows_bound_the_weights(share):
    weights = np.exp(mixture_log_weights(LOGS, share))
    assert np.isfinite(weights).all()
    assert weights.max() <= 1 / share * (1 + 1e-12)


def test_effective_size():
    assert effective_size(np.ones(7)) == pytest.approx(7)
    assert effective_size(np.array([1e-200, 0.0])) == pytest.approx(1)
    assert effective_size(np.array([3.0, 1.0])) == pytest.approx(1.6)
    assert effective_size(np.zeros(3)) == effective_size(np.zeros(0)) == 0.0


def test_quality_of_a_sample():
    weights, failing = np.array([1.0, 2.0, 3.0, 0.5]), np.array([False, True, True, False])
    found = quality(weights, failing, target_rows=2)
    assert found.mean == pytest.approx(1.625)
    assert found.effective_failures == pytest.approx(25 / 13)
    assert found.largest_share == pytest.approx(0.6)
    assert found.standard_error == pytest.approx(np.sqrt((2 * 0.5 + 2 * 3.125) / 16))
    assert quality(weights, np.zeros(4, bool), 2).largest_share == 0.0


def test_stratified_variance_is_that_of_the_mean():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(5, 1, (4000, 20)), rng.normal(0, 2, (4000, 80))], axis=1)
    estimates = [stratified_variance(row, 20) for row in values]
    assert np.mean(estimates) == pytest.approx(values.mean(axis=1).var(), rel=0.08)


def test_annealing_keeps_the_order_and_the_effective_size():
    logs = np.random.default_rng(1).normal(0, 6, 60)
    weights = anneal(logs, 30.0)
    assert effective_size(weights) == pytest.approx(30.0, rel=1e-3)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_array_equal(np.argsort(weights), np.argsort(logs))
    mild = anneal(0.01 * logs, 30.0)
    np.testing.assert_allclose(mild, np.exp(0.01 * logs) / np.exp(0.01 * logs).sum())


def test_resampling_is_in_proportion():
    weights = np.array([1.0, 0.0, 2.0, 5.0])
    counts = np.bincount(resample(weights, 80, 0.3), minlength=4)
    np.testing.assert_array_equal(counts, [10, 0, 20, 50])


def test_mixture_density_integrates_to_one():
    """Check E_q[p/q] = 1 and E_p[q/p] = 1: a wrong constant or sign of the density breaks one of them."""
    law = GaussianMixture(
        np.array([0.3, 0.7]), np.array([[[0.5, 0.0]], [[-0.4, 0.3]]]), np.full((2, 1, 2), 0.9)
    )
    rng = np.random.default_rng(2)
    for tapes, sign in ((law.sample(rng, 40000), 1), (rng.standard_normal((40000, 1, 2)), -1)):
        values = np.exp(sign * law.log_ratio(tapes))
        assert abs(values.mean() - 1) < 4 * values.std() / 200
        assert values.std() > 0.1
