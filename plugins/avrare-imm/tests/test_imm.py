"""The filter against the textbook written as scalar loops, and what must hold of any run."""

from dataclasses import replace

import numpy as np
import pytest

from avrare_imm.imm import Mixture, forecast, fuse, step
from avrare_imm.models import lateral_models, longitudinal_models, look_ahead

LATERAL = lateral_models((3.0, 4.0, 5.0), 7.0, (-1.75, 1.75, 5.25), 0.1, 0.1, 0.1, 0.95)
LONGITUDINAL = longitudinal_models(("cv", "ca"), 0.1, 1.0, (0.1, 0.1), 0.95)
BOTH = pytest.mark.parametrize("models", [LONGITUDINAL, LATERAL], ids=["longitudinal", "lateral"])


def begin(models, rng, shape) -> Mixture:
    m, n = models.offset.shape
    root = rng.normal(size=(*shape, m, n, n))
    covariance = np.einsum("...ij,...kj->...ik", root, root) + np.eye(n)
    chance = rng.random((*shape, m)) + 0.01
    mean = rng.normal(0, 3, (*shape, m, n))
    return Mixture(mean, covariance, chance / chance.sum(-1, keepdims=True))


def lopsided(models, rng):
    """Return the same models with a transition matrix that is not symmetric."""
    matrix = models.transition + rng.uniform(0, 0.3, models.transition.shape)
    return replace(models, transition=matrix / matrix.sum(1, keepdims=True))


def observe(models, rng, shape, missing=0.4):
    detected = rng.random(shape) >= missing
    measurement = rng.normal(0, 3, (*shape, len(models.measurement_variance)))
    return np.where(detected[..., None], measurement, np.nan), detected


def literal(models, mean, covariance, chance, measurement, detected):
    """Run one cycle of one track: the recursion of the textbook, one mode after another."""
    m, n = models.offset.shape
    p = len(models.measurement_variance)
    H, R = np.eye(n)[:p], np.diag(models.measurement_variance)
    new_mean, new_covariance, new_chance = np.zeros((m, n)), np.zeros((m, n, n)), np.zeros(m)
    for j in range(m):
        total = sum(models.transition[i, j] * chance[i] for i in range(m))
        weights = [models.transition[i, j] * chance[i] / total for i in range(m)]
        x0 = sum(weights[i] * mean[i] for i in range(m))
        P0 = sum(weights[i] * (covariance[i] + np.outer(mean[i] - x0, mean[i] - x0)) for i in range(m))
        F = models.dynamics[j]
        x, P, likelihood = F @ x0 + models.offset[j], F @ P0 @ F.T + models.noise[j], 1.0
        if detected:
            S = H @ P @ H.T + R
            r = measurement - H @ x
            K = P @ H.T @ np.linalg.inv(S)
            likelihood = np.exp(-0.5 * r @ np.linalg.inv(S) @ r) / np.sqrt(np.linalg.det(2 * np.pi * S))
            x, P = x + K @ r, P - K @ S @ K.T
        new_mean[j], new_covariance[j], new_chance[j] = x, P, total * likelihood
    return new_mean, new_covariance, new_chance / new_chance.sum()


@BOTH
def test_equals_scalar_loops_with_and_without_detection(models):
    rng = np.random.default_rng(2)
    models = lopsided(models, rng)
    track = begin(models, rng, (4, 3))
    parts = (track.mean, track.covariance, track.probability)
    reference = {at: [part[at] for part in parts] for at in np.ndindex(4, 3)}
    for _ in range(25):
        measurement, detected = observe(models, rng, (4, 3))
        track = step(models, track, measurement, detected)
        for at, old in reference.items():
            reference[at] = new = literal(models, *old, measurement[at], detected[at])
            for ours, theirs in zip((track.mean, track.covariance, track.probability), new, strict=True):
                np.testing.assert_allclose(ours[at], theirs, rtol=1e-9, atol=1e-9)


@BOTH
def test_missed_detection_only_mixes_and_predicts(models):
    rng = np.random.default_rng(3)
    models = lopsided(models, rng)
    track = begin(models, rng, (2, 2))
    p = len(models.measurement_variance)
    missed = step(models, track, np.full((2, 2, p), np.nan), np.zeros((2, 2), bool))
    expected = np.einsum("nvi,ij->nvj", track.probability, models.transition)
    np.testing.assert_allclose(missed.probability, expected, rtol=1e-13)
    junk = step(models, track, np.full((2, 2, p), 1e300), np.zeros((2, 2), bool))
    for name in ("mean", "covariance", "probability"):
        np.testing.assert_array_equal(getattr(missed, name), getattr(junk, name))


@BOTH
def test_vehicles_do_not_depend_on_each_other(models):
    rng = np.random.default_rng(5)
    full = begin(models, rng, (5, 4))
    measurement, detected = observe(models, rng, (5, 4))
    whole = step(models, full, measurement, detected)
    names, third = ("mean", "covariance", "probability"), slice(2, 3)
    one = Mixture(*(getattr(full, name)[:, third] for name in names))
    alone = step(models, one, measurement[:, third], detected[:, third])
    for name in names:
        np.testing.assert_array_equal(getattr(whole, name)[:, third], getattr(alone, name))


@BOTH
def test_forecast_equals_stepping_every_mode(models):
    rng = np.random.default_rng(6)
    track = begin(models, rng, (3, 2))
    positions = forecast(look_ahead(models, 20), track)
    assert positions.shape == (3, 2, 21)
    np.testing.assert_array_equal(positions[..., 0], fuse(track)[0][..., 0])
    for at in np.ndindex(3, 2):
        states = list(track.mean[at])
        for k in range(21):
            expected = sum(q * s[0] for q, s in zip(track.probability[at], states, strict=True))
            assert positions[at][k] == pytest.approx(expected, abs=1e-10)
            states = [F @ s + E for F, s, E in zip(models.dynamics, states, models.offset, strict=True)]


@BOTH
def test_long_runs_stay_positive_definite_and_normalised(models):
    rng = np.random.default_rng(7)
    track = begin(models, rng, (6, 2))
    for _ in range(200):
        track = step(models, track, *observe(models, rng, (6, 2)))
        for covariance in (track.covariance, fuse(track)[1]):
            np.testing.assert_array_equal(covariance, covariance.swapaxes(-1, -2))
            assert np.linalg.eigvalsh(covariance).min() > 0
        assert (track.probability > 0).all()
        np.testing.assert_allclose(track.probability.sum(-1), 1, rtol=0, atol=1e-12)


def test_process_noise_is_one_random_acceleration_a_step():
    g = np.array([0.005, 0.1, 1.0])
    np.testing.assert_allclose(LONGITUDINAL.noise[1], np.outer(g, g))
    np.testing.assert_allclose(LATERAL.noise[4], 0.1 * np.outer(g[:2], g[:2]))


def test_lateral_models_converge_to_their_lane():
    for k, lane in enumerate((-1.75, 1.75, 5.25) * 3):
        rest = np.array([lane, 0.0])
        np.testing.assert_allclose(LATERAL.dynamics[k] @ rest + LATERAL.offset[k], rest, atol=1e-12)
