"""Interacting multiple models (Blom and Bar-Shalom 1988) for a batch of tracks.

Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation* (2001),
section 11.6.6. Arrays are handed around with the particles first, (N, V, M, ...), and computed on as their
transposes (..., M, V, N): every operation is then elementwise over the particles, in one order, so that no
track depends on its neighbours in the batch, not even in its last bit. The same reason forbids ``np.sum``
over the modes, whose order of additions follows the shape of the batch.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare_imm.models import ModelSet, Rollout

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Mixture:
    """A Gaussian for each of M modes, for N particles and V vehicles.

    Attributes:
        mean: (N, V, M, n).
        covariance: (N, V, M, n, n), symmetric.
        probability: (N, V, M), sums to 1 over the modes.
    """

    mean: Floats
    covariance: Floats
    probability: Floats


def step(models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
    """One cycle of the filter: mix, predict, update.

    Args:
        models: M models of n states.
        mixture: Estimate one step ago.
        measurement: (N, V, p); anything, NaN too, where nothing was detected.
        detected: (N, V).
    """
    return update(models, predict(models, mix(models, mixture)), measurement, detected)


def mix(models: ModelSet, mixture: Mixture) -> Mixture:
    """Start each mode from what the modes before it, weighted by how likely they led to it, believed."""
    mean, covariance, probability = _particles_last(mixture)
    joint = [row[:, None, None] * chance for row, chance in zip(models.transition, probability, strict=True)]
    now = _sum(joint)
    weights = [before / now for before in joint]
    mixed, spread = _merge(weights, mean[:, :, None], covariance[:, :, :, None])
    return Mixture(mixed.T, spread.T, now.T)


def predict(models: ModelSet, mixture: Mixture) -> Mixture:
    """Move every mode one step on with its own model."""
    mean, covariance, _ = _particles_last(mixture)
    dynamics = _per_mode(models.dynamics)
    moved = _product(dynamics, mean[:, None])[:, 0] + _per_mode(models.offset)
    spread = _sandwich(dynamics, covariance) + _per_mode(models.noise)
    return Mixture(moved.T, spread.T, mixture.probability)


def update(models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
    """Kalman update (Joseph form) of every mode and Bayes' rule for their probabilities.

    A missed detection is an update with zero gain and no evidence: it leaves the track as it is.
    """
    mean, covariance, probability = _particles_last(mixture)
    seen = np.ascontiguousarray(detected.T)
    measured = np.where(seen, np.ascontiguousarray(measurement.T), 0.0)
    p = len(models.measurement_variance)
    residual = np.where(seen, measured[:, None] - mean[:p], 0.0)
    variance = models.measurement_variance[:, None, None, None]
    inverse, log_determinant = _invert(covariance[:p, :p] + np.eye(p)[..., None, None, None] * variance)
    gain = np.where(seen, _product(covariance[:, :p], inverse), 0.0)

    keep = np.broadcast_to(np.eye(len(mean))[..., None, None, None], covariance.shape).copy()
    keep[:, :p] -= gain
    noise = _sum(variance[a] * _outer(gain[:, a], gain[:, a]) for a in range(p))
    moved = mean + _product(gain, residual[:, None])[:, 0]
    distance = _sum(residual * _product(inverse, residual[:, None])[:, 0])
    posterior = _posterior(probability, -0.5 * (distance + log_determinant))
    return Mixture(moved.T, (_sandwich(keep, covariance) + noise).T, np.where(seen, posterior, probability).T)


def fuse(mixture: Mixture) -> tuple[Floats, Floats]:
    """Mean (N, V, n) and covariance (N, V, n, n) of the whole mixture."""
    mean, covariance, probability = _particles_last(mixture)
    centre, spread = _merge(list(probability), mean, covariance)
    return centre.T, spread.T


def forecast(ahead: Rollout, mixture: Mixture) -> Floats:
    """(N, V, H + 1) expected position: each mode rolled on by itself, averaged by its probability [m].

    Args:
        ahead: The rollouts of the models.
        mixture: Estimate of now; entry 0 is its fused position.
    """
    mean, _, probability = _particles_last(mixture)
    total = np.zeros((len(ahead.weight), *probability.shape[1:]))
    for m, chance in enumerate(probability):
        for weight, component in zip(ahead.weight[:, m].T, mean[:, m], strict=True):
            total += weight[:, None, None] * (chance * component)
        total += ahead.offset[:, m, None, None] * chance
    return np.ascontiguousarray(total.T)


def _merge(weights: list[Floats], mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of a mixture; its modes are axis 1 of ``mean`` and axis 2 of ``covariance``."""
    means = list(mean.swapaxes(0, 1))
    centre = _sum(weight * each for weight, each in zip(weights, means, strict=True))
    spread = np.zeros((len(centre), *centre.shape))
    for m, weight in enumerate(weights):
        gap = means[m] - centre
        term = _outer(gap, gap)
        term += covariance[:, :, m]  # in place: fresh arrays of this size cost more than the arithmetic
        term *= weight
        spread += term
    return centre, spread


def _particles_last(mixture: Mixture) -> tuple[Floats, Floats, Floats]:
    """Mean (n, M, V, N), covariance (n, n, M, V, N) and probability (M, V, N)."""
    mean, covariance, probability = (
        np.ascontiguousarray(leaf.T) for leaf in (mixture.mean, mixture.covariance, mixture.probability)
    )
    return mean, covariance, probability


def _per_mode(values: Floats) -> Floats:
    """(M, ...) as (..., M, 1, 1), to meet particles-last arrays."""
    return np.moveaxis(values, 0, -1)[..., None, None]


def _sum(terms: Iterable[Floats]) -> Floats:
    """Sum of one or more arrays of one shape, in the order given."""
    iterator = iter(terms)
    total = next(iterator).copy()
    for term in iterator:
        total += term
    return total


def _outer(a: Floats, b: Floats) -> Floats:
    """(n, ...), (k, ...) -> (n, k, ...)."""
    return a[:, None] * b[None]


def _product(a: Floats, b: Floats) -> Floats:
    """Matrix product over the first two axes: (i, k, ...), (k, j, ...) -> (i, j, ...).

    A vector is handed in as (k, 1, ...).
    """
    return _sum(_outer(a[:, k], b[k]) for k in range(len(b)))


def _sandwich(a: Floats, covariance: Floats) -> Floats:
    """A P A^T, symmetric to the last bit."""
    product = _product(_product(a, covariance), a.swapaxes(0, 1))
    return 0.5 * (product + product.swapaxes(0, 1))


def _invert(matrix: Floats) -> tuple[Floats, Floats]:
    """Inverse and log-determinant of symmetric matrices (p, p, ...) with p = 1 or 2."""
    if len(matrix) == 1:
        return 1.0 / matrix, np.log(matrix[0, 0])
    (a, b), (_, d) = matrix
    determinant = a * d - b * b
    return np.array([[d, -b], [-b, a]]) / determinant, np.log(determinant)


def _posterior(prior: Floats, log_likelihood: Floats) -> Floats:
    """Bayes' rule over the first axis, by log-sum-exp so that no outlier empties all modes."""
    log_joint = np.log(prior) + log_likelihood
    joint: Floats = np.exp(log_joint - log_joint.max(axis=0))
    return joint / _sum(joint)
