"""Joint laws, and systems over them."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

import avrare
from avrare.testing.static_problems import Static, Values, row_sum
from avrare_flows import transform_noise
from avrare_flows.laws import Joint
from avrare_flows.marginals import Exponential, Gamma, LogNormal, Normal

R = [[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]]
JOINT = Joint([Exponential(), Normal(1.0, 2.0), Gamma(2.0)], R)


class Total(Static):
    def signals(self, state: Values):
        return {"total": row_sum(state.values)}


@dataclass(frozen=True)
class Position:
    x: np.ndarray


class Walk:
    """Steps of physical length."""

    noise_size = 1

    def initial(self, noise):
        return Position(noise[:, 0])

    def step(self, state, noise):
        return Position(state.x + noise[:, 0])

    def signals(self, state):
        return {"x": state.x}

    def faults(self, state):
        return state.x > 1e6


def test_a_copula_keeps_the_laws_and_correlates_the_ranks():
    x = JOINT.physical(np.random.default_rng(0).standard_normal((50_000, 3)))
    for column, law in zip(x.T, (stats.expon(), stats.norm(1.0, 2.0), stats.gamma(2.0)), strict=True):
        assert stats.kstest(column, law.cdf).pvalue > 1e-3
    rank = stats.spearmanr(x).statistic
    np.testing.assert_allclose(rank, 6.0 / np.pi * np.arcsin(np.array(R) / 2.0), atol=0.02)


def test_the_density_of_a_copula_is_that_of_the_transform():
    z = np.random.default_rng(2).standard_normal((20, 3))
    _, log_det = JOINT.warp(z)
    step = 1e-6
    jacobian = np.stack(
        [(JOINT.physical(z + step * e) - JOINT.physical(z - step * e)) / (2 * step) for e in np.eye(3)],
        axis=2,
    )
    np.testing.assert_allclose(log_det, np.linalg.slogdet(jacobian)[1], rtol=1e-6, atol=1e-6)
    flat = stats.multivariate_normal([0, 0], [[1, 0.5], [0.5, 1]])
    normal = Joint([Normal(), Normal()], [[1, 0.5], [0.5, 1]])
    np.testing.assert_allclose(normal.log_density(z[:, :2]), flat.logpdf(z[:, :2]), rtol=1e-12)


@pytest.mark.parametrize("estimator", ["mc", "ams", "ess"])
def test_every_estimator_runs_on_physical_noise(estimator):
    """Estimate how often the sum of three Exp(1) reaches 10: Erlang's law, 2.77e-3."""
    problem = avrare.Problem(
        transform_noise(Total(3), Joint([Exponential()] * 3)), avrare.stl("total < 10"), 0
    )
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
    assert np.array_equal(state.x, np.exp(2.0 + z[:, 0]))
    assert np.array_equal(walk.step(state, z).x, state.x + Joint([Exponential()]).physical(z)[:, 0])
    assert walk.faults(state).tolist() == [False, False]
    assert walk.warnings == {}
    assert transform_noise(Total(1), Joint([Normal()])).faults(None) is None
