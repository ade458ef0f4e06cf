"""The filter against an independent implementation, on steps with a detection."""

import numpy as np
import pytest
from filterpy import kalman

from avrare_imm.config import ImmConfig
from avrare_imm.imm import Mixture, fuse, step
from avrare_imm.models import ModelSet, lateral_models, longitudinal_models

LANES = (-1.75, 1.75, 5.25)
CONFIG = ImmConfig()
MOVING, LATERAL = (
    lateral_models(CONFIG.derivative_gains, 7.0, LANES, 0.1, 0.1, 0.1, 0.95, stands=stands)
    for stands in (False, True)
)
LONGITUDINAL = longitudinal_models(CONFIG.longitudinal_models, 0.1, 1.0, (0.1, 0.1), 0.95)


def oracle(models: ModelSet, state, probability):
    """Return filterpy's estimator with the same models; affine terms are the control input B u, u = 1."""
    m, n = models.offset.shape
    p = len(models.measurement_variance)
    filters = []
    for k in range(m):
        one = kalman.KalmanFilter(dim_x=n, dim_z=p)
        one.x, one.P = np.array(state, dtype=float).reshape(n, 1), np.eye(n)
        one.F, one.Q, one.B = models.dynamics[k], models.noise[k], np.diag(models.offset[k])
        one.H, one.R = np.eye(n)[:p], np.diag(models.measurement_variance)
        filters.append(one)
    return kalman.IMMEstimator(filters, probability, models.transition)


def track(models: ModelSet, states, probability) -> Mixture:
    """Return the same start for a batch of (N, V, n) states."""
    m, n = models.offset.shape
    shape = states.shape[:2]
    return Mixture(
        np.repeat(states[:, :, None], m, axis=2),
        np.broadcast_to(np.eye(n), (*shape, m, n, n)),
        np.broadcast_to(np.asarray(probability), (*shape, m)),
    )


@pytest.mark.parametrize(
    ("models", "prior"),
    [
        (LONGITUDINAL, [0.3, 0.3, 0.4]),
        (LATERAL, np.array([*[1, 9, 1] * 3, 7]) / 40),
    ],
    ids=["longitudinal", "lateral"],
)
def test_equals_filterpy(models, prior):
    rng = np.random.default_rng(1)
    n, p = models.offset.shape[1], len(models.measurement_variance)
    states = rng.normal(0, 3, (3, 2, n))
    ours = track(models, states, prior)
    theirs = [[oracle(models, state, prior) for state in row] for row in states]
    for _ in range(30):
        measurement = states[..., :p] + rng.normal(0, 2, (3, 2, p))
        ours = step(models, ours, measurement, np.ones((3, 2), bool))
        mean, covariance = fuse(ours)
        for i in range(3):
            for j in range(2):
                imm = theirs[i][j]
                imm.predict(np.ones((n, 1)))
                imm.update(measurement[i, j][:, None])
                np.testing.assert_allclose(ours.probability[i, j], imm.mu, rtol=0, atol=1e-9)
                np.testing.assert_allclose(mean[i, j], imm.x[:, 0], rtol=0, atol=1e-9)
                np.testing.assert_allclose(covariance[i, j], imm.P, rtol=0, atol=1e-9)
                for k, one in enumerate(imm.filters):
                    np.testing.assert_allclose(ours.mean[i, j, k], one.x[:, 0], rtol=0, atol=1e-9)
                    np.testing.assert_allclose(ours.covariance[i, j, k], one.P, rtol=0, atol=1e-9)


def test_a_far_outlier_does_not_underflow_the_likelihood():
    prior = np.array([1, 9, 1] * 3) / 33
    state = np.array([1.75, 0.0])
    ours = track(MOVING, state[None, None], prior)
    theirs = oracle(MOVING, state, prior)
    for y in (1.75, 1e4):
        before = theirs.mu @ MOVING.transition
        theirs.predict(np.ones((2, 1)))
        theirs.update(np.array([[y]]))
        ours = step(MOVING, ours, np.full((1, 1, 1), y), np.ones((1, 1), bool))
    np.testing.assert_allclose(theirs.mu, before, atol=1e-12)  # equal floors: the measurement said nothing
    chance = ours.probability[0, 0]
    assert np.isfinite(chance).all()
    assert chance.sum() == pytest.approx(1, abs=1e-12)
    assert chance.reshape(3, 3)[:, 2].sum() > 0.99  # the leftmost lane explains it best
    assert all(np.isfinite(part).all() for part in fuse(ours))
