"""Joint laws, and systems over them."""

import numpy as np
import pytest
from scipy import stats

import avrare
from avrare_flows import transform_noise
from avrare_flows.laws import Joint
from avrare_flows.marginals import Exponential, Gamma, LogNormal, Normal
from plain_systems import Sum, Total

R = [[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]]
JOINT = Joint([Exponential(), Normal(1.0, 2.0), Gamma(2.0)], R)


class Walk(Sum):
    """Steps of physical length."""

    def faults(self, state):
        return state["x"] > 1e6


def test_a_copula_keeps_the_laws_and_correlates_the_ranks():
    x = JOINT.physical(np.random.default_rng(0).standard_normal((50_000, 3)))
    for column, law in zip(x.T, (stats.expon(), stats.norm(1.0, 2.0), stats.gamma(2.0)), strict=True):
        assert stats.kstest(column, law.cdf).pvalue > 1e-3
    rank = stats.spearmanr(x).statistic
    np.testing.assert_allclose(rank, 6.0 / np.pi * np.arcsin(np.array(R) / 2.0), atol=0.02)


def test_the_density_of_a_copula_is_that_of_the_transform():
    z = np.random.default_rng(2).standard_normal((20, 3))
    _, log_det = JOINT.warp(z)
    steps = 1e-6 * np.eye(3)
    columns = [(JOINT.physical(z + step) - JOINT.physical(z - step)) / 2e-6 for step in steps]
    expected = np.linalg.slogdet(np.stack(columns, axis=2))[1]
    np.testing.assert_allclose(log_det, expected, rtol=1e-6, atol=1e-6)
    flat = stats.multivariate_normal([0, 0], [[1, 0.5], [0.5, 1]])
    normal = Joint([Normal(), Normal()], [[1, 0.5], [0.5, 1]])
    np.testing.assert_allclose(normal.log_density(z[:, :2]), flat.logpdf(z[:, :2]), rtol=1e-12)


@pytest.mark.parametrize("estimator", ["mc", "ams", "ess"])
def test_every_estimator_runs_on_physical_noise(estimator):
    """Estimate how often the sum of three Exp(1) reaches 10: Erlang's law, 2.77e-3."""
    system = transform_noise(Total(3), Joint([Exponential()] * 3))
    problem = avrare.Problem(system, avrare.stl("total < 10"), 0)
    options = {"mc": {"rollouts": 100_000}, "ams": {"particles": 4000, "discard": 400}, "ess": {"runs": 20}}
    result = avrare.estimate(problem, estimator, seed=5, **options[estimator])
    exact = np.exp(-10.0) * (1.0 + 10.0 + 50.0)
    error = result.relative_error * result.probability
    assert abs(result.probability - exact) < 4.0 * error
    assert error < 0.15 * exact


def test_the_start_may_have_a_law_of_its_own():
    walk = transform_noise(Walk(), Joint([Exponential()]), initial=Joint([LogNormal(2.0, 1.0)]))
    z = np.array([[0.3], [-1.0]])
    state = walk.initial(z)
    assert np.array_equal(state["x"], np.exp(2.0 + z[:, 0]))
    assert np.array_equal(walk.step(state, z)["x"], state["x"] + Joint([Exponential()]).physical(z)[:, 0])
    assert walk.faults(state).tolist() == [False, False]
    assert walk.warnings == {}
    assert transform_noise(Total(1), Joint([Normal()])).faults(None) is None
