"""The tracker on filterpy against ``imm``, and the filter against filterpy's on steps with a detection."""

import numpy as np
import pytest
from filterpy import kalman

from avrare.base.errors import UsageError
from avrare.driving import Observation
from avrare.testing.conformance import sample_traffic
from avrare_imm import filterpy_tracker
from avrare_imm.config import ImmConfig
from avrare_imm.imm import Mixture, fuse, step
from avrare_imm.models import ModelSet, lateral_models, longitudinal_models
from avrare_imm.tracker import ImmTracker

N = 3


def observations(steps, missed=0.0):
    rng = np.random.default_rng(4)
    for k in range(1, steps + 1):
        others = sample_traffic.world(rng.standard_normal((N, 4)), k).others
        seen = rng.random(others.x.shape) >= missed
        fields = (others.x, others.y, others.speed)
        x, y, speed = (np.where(seen, v + rng.normal(0, 0.4, v.shape), np.nan) for v in fields)
        yield Observation(seen, x, y, speed)


def both(**options):
    config, scene = ImmConfig(**options), sample_traffic.scene()
    world = sample_traffic.world(np.zeros((N, 4)), 0)
    trackers = ImmTracker(config, scene), filterpy_tracker.FilterpyTracker(config, scene)
    return trackers, [tracker.start(world) for tracker in trackers]


def compare(ours, theirs, track, other):
    for name, value in vars(ours.estimate(track)).items():
        np.testing.assert_allclose(vars(theirs.estimate(other))[name], value, rtol=0, atol=1e-9, err_msg=name)
    mine, its = ours.predict(track, 5), theirs.predict(other, 5)
    np.testing.assert_allclose([its.x, its.y], [mine.x, mine.y], rtol=0, atol=1e-8)


@pytest.mark.parametrize("missed", [0.0, 0.4])
def test_it_agrees_with_imm_on_detections_and_on_misses(missed):
    (ours, theirs), (track, other) = both()
    for observation in observations(12, missed):
        track, other = ours.update(track, observation), theirs.update(other, observation)
        compare(ours, theirs, track, other)


def test_gate_and_track_life_are_those_of_imm():
    (ours, theirs), (track, other) = both(gate=3.0, start="empty", death=2)
    for observation in observations(12, 0.3):
        track, other = ours.update(track, observation), theirs.update(other, observation)
        np.testing.assert_array_equal(track.life.exists, other.life.exists)
        compare(ours, theirs, track, other)


def test_a_single_model_is_refused():
    with pytest.raises(UsageError, match="at least two longitudinal models"):
        filterpy_tracker.build(ImmConfig(longitudinal_models=("cv",)), sample_traffic.scene())
    with pytest.raises(UsageError, match="'filterpy' needs a driving simulator"):
        filterpy_tracker.build(ImmConfig(), None)


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
    (m, n), shape = models.offset.shape, states.shape[:2]
    mean, covariance = np.repeat(states[:, :, None], m, axis=2), np.broadcast_to(np.eye(n), (*shape, m, n, n))
    return Mixture(mean, covariance, np.broadcast_to(np.asarray(probability), (*shape, m)))


@pytest.mark.parametrize(
    ("models", "prior"),
    [(LONGITUDINAL, [0.3, 0.3, 0.4]), (LATERAL, np.array([*[1, 9, 1] * 3, 7]) / 40)],
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
        for at in np.ndindex(3, 2):
            imm = theirs[at[0]][at[1]]
            imm.predict(np.ones((n, 1)))
            imm.update(measurement[at][:, None])
            pairs = [(ours.probability[at], imm.mu), (mean[at], imm.x[:, 0]), (covariance[at], imm.P)]
            pairs += [(ours.mean[at][k], one.x[:, 0]) for k, one in enumerate(imm.filters)]
            pairs += [(ours.covariance[at][k], one.P) for k, one in enumerate(imm.filters)]
            for found, expected in pairs:
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


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
