"""Importance weights: definitions, bounds, and what they report of themselves."""

import numpy as np
import pytest

from avrare_estimators.ce.gaussian_family import default_components, fit_mixture, limit_divergence
from avrare_estimators.common.tapes.gaussian_mixture import GaussianMixture
from avrare_estimators.common.weights import (
    annealed,
    effective_size,
    mixture_log_weights,
    quality,
    resample,
    stratified_variance,
)
from avrare_estimators.importance.config import IsConfig

LOGS = np.array([-800.0, -3.0, 0.0, 2.5, 800.0, np.inf, -np.inf])


def test_mixture_weights_are_p_over_the_mixture():
    ratio = np.exp(LOGS[1:4])
    np.testing.assert_allclose(np.exp(mixture_log_weights(LOGS[1:4], 0.2)), ratio / (0.2 * ratio + 0.8))


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 1.0])
def test_defensive_rows_bound_the_weights(share):
    weights = np.exp(mixture_log_weights(LOGS, share))
    assert np.isfinite(weights).all()
    assert weights.max() <= 1 / share * (1 + 1e-12)


def test_without_defensive_rows_weights_are_the_ratio():
    np.testing.assert_array_equal(mixture_log_weights(LOGS, 0.0), LOGS)


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
    weights = annealed(logs, 30.0)
    assert effective_size(weights) == pytest.approx(30.0, rel=1e-3)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_array_equal(np.argsort(weights), np.argsort(logs))
    mild = annealed(0.01 * logs, 30.0)
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


def test_log_ratio_rows_do_not_depend_on_their_neighbours():
    law = GaussianMixture(np.array([0.3, 0.7]), np.ones((2, 7, 3)), np.full((2, 7, 3), 0.9))
    tapes = np.random.default_rng(3).standard_normal((50, 7, 3))
    whole = law.log_ratio(tapes)
    for part in (slice(0, 1), slice(13, 31), [4, 40]):
        assert law.log_ratio(tapes[part]).tobytes() == whole[part].tobytes()


def test_fit_finds_what_matters_and_leaves_the_rest():
    rng = np.random.default_rng(4)
    tapes = rng.standard_normal((400, 10, 10))
    tapes[:, 3, 4] = 2.0 + 0.5 * tapes[:, 3, 4]
    law = fit_mixture(tapes, np.full(400, 1 / 400), None, 1, 0.1)
    assert law.mean[0, 3, 4] == pytest.approx(2.0, abs=0.1)
    assert law.std[0, 3, 4] == pytest.approx(0.5, abs=0.1)
    others = np.ones((10, 10), bool)
    others[3, 4] = False
    assert (law.mean[0][others] == 0.0).mean() > 0.5
    assert fit_mixture(tapes, np.full(400, 1 / 400), None, 1, 0.8).std.min() == 0.8


def test_the_divergence_of_a_learnt_law_is_limited():
    rng = np.random.default_rng(6)
    law = GaussianMixture(np.ones(1), rng.normal(0, 0.3, (1, 40, 12)), rng.uniform(0.8, 1.1, (1, 40, 12)))
    tapes = limit_divergence(law, 3.0).sample(rng, 4000)
    far = -limit_divergence(law, 3.0).log_ratio(tapes)
    assert far.mean() == pytest.approx(3.0, abs=0.2)
    near = GaussianMixture(np.ones(1), 0.1 * law.mean, np.ones((1, 40, 12)))
    np.testing.assert_array_equal(limit_divergence(near, 3.0).mean, near.mean)


def test_mixture_finds_two_modes():
    rng = np.random.default_rng(5)
    tapes = 0.4 * rng.standard_normal((300, 1, 2))
    tapes[:100, 0, 0] += 3.0
    tapes[100:, 0, 0] -= 3.0
    law = fit_mixture(tapes, np.full(300, 1 / 300), None, 2, 0.1)
    order = np.argsort(law.mean[:, 0, 0])
    np.testing.assert_allclose(law.mean[order, 0, 0], [-3, 3], atol=0.15)
    np.testing.assert_allclose(law.share[order], [2 / 3, 1 / 3], atol=0.02)


@pytest.mark.parametrize(("rows", "components"), [(2, 1), (199, 1), (200, 2), (500, 4), (5000, 4)])
def test_few_tapes_are_fitted_by_one_gaussian(rows, components):
    assert default_components(rows) == components


@pytest.mark.parametrize(
    "wrong", [3, "x", {}, {"gaussian": 1}, {"name": "gaussian", "sigma": 1}, {"name": "normal"}, object()]
)
def test_invalid_proposals_are_refused(wrong):
    with pytest.raises(ValueError, match=r"proposal"):
        IsConfig(proposal=wrong)


def test_a_proposal_is_an_array_or_an_object():
    assert IsConfig(proposal={"name": "gaussian", "mean": np.ones(2)}).proposal.mean == [1.0, 1.0]
    law = GaussianMixture.single(0.0, 1.0, (1, 2))
    assert IsConfig(proposal=law).proposal is law
