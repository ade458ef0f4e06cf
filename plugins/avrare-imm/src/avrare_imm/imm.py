"""Interacting multiple models (Blom and Bar-Shalom 1988) for a batch of tracks.

Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation* (2001),
section 11.6.6. Arrays have the particles first, (N, V, M, ...), and are computed on as their transposes
(..., M, V, N): every operation is then elementwise over the particles, in one order, so that no track
depends on its neighbours in the batch, not even in its last bit. For the same reason ``np.sum`` over the
modes is not used: its order of additions depends on the shape of the batch.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_imm.models import Horizon, ModelSet


@dataclass(frozen=True)
class Mixture:
    """Gaussian mixture of M modes, for N particles and V vehicles.

    Attributes:
        mean: (N, V, M, n) means.
        covariance: (N, V, M, n, n) symmetric covariances.
        probability: (N, V, M) probabilities, which sum to 1 over the modes.
    """

    mean: Floats
    covariance: Floats
    probability: Floats


def step(models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
    """Run one cycle of the filter: mix, predict, update.

    Args:
        models: M models of n states.
        mixture: Estimate one step ago.
        measurement: (N, V, p) measurements; ignored, NaN allowed, where nothing was detected.
        detected: (N, V) whether the vehicle was detected.
    """
    return update(models, predict(models, mix(models, mixture)), measurement, detected)


def mix(models: ModelSet, mixture: Mixture) -> Mixture:
    """Start each mode from the mixture of the previous modes, weighted by their transition probabilities."""
    mean, covariance, probability = _particles_last(mixture)
    joint = [row[:, None, None] * chance for row, chance in zip(models.transition, probability, strict=True)]
    now = _sum(joint)
    weights = [before / now for before in joint]
    mixed, spread = _merge(weights, mean[:, :, None], covariance[:, :, :, None])
    return Mixture(mixed.T, spread.T, now.T)


def predict(models: ModelSet, mixture: Mixture) -> Mixture:
    """Predict every mode by one step with its own model."""
    mean, covariance, _ = _particles_last(mixture)
    dynamics = _per_mode(models.dynamics)
    moved = _product(dynamics, mean[:, None])[:, 0] + _per_mode(models.offset)
    spread = _sandwich(dynamics, covariance) + _per_mode(models.noise)
    return Mixture(moved.T, spread.T, mixture.probability)


def update(models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
    """Update every mode (Kalman, Joseph form) and their probabilities (Bayes' rule).

    A missed detection is an update with zero gain and no evidence: the track stays the same.
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


def same_modes(state: Floats, variances: Sequence[float], probability: Floats) -> Mixture:
    """Return modes of (N, V, M) chances that are all at ``state`` (N, V, n), with independent components."""
    m = probability.shape[-1]
    covariance = np.diag(np.array(variances, dtype=float))
    means = np.repeat(state[:, :, None], m, axis=2)
    return Mixture(means, np.tile(covariance, (*state.shape[:2], m, 1, 1)), probability)


def choose(where: Bools, first: Mixture, second: Mixture) -> Mixture:
    """Return ``first`` where (N, V) ``where`` is true, else ``second``."""
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return Mixture(*(np.where(where.reshape(*where.shape, *[1] * (a.ndim - 2)), a, b) for a, b in pairs))


def set_probability(mixture: Mixture, mode: int, chance: Floats) -> Mixture:
    """Return the mixture whose ``mode`` has the probability ``chance`` (N, V), the others the rest."""
    probability = mixture.probability.copy()
    rest = _rest(probability, mode)
    probability *= ((1.0 - chance) / rest)[..., None]
    probability[..., mode] = chance
    return Mixture(mixture.mean, mixture.covariance, probability)


def agree(first: Mixture, first_mode: int, second: Mixture, second_mode: int, prior: Floats) -> Floats:
    """Return the probability (N, V) of a mode of two filters after the measurements of both.

    Each filter had given the mode the probability ``prior`` and has updated it by measurements of its own.
    """
    first_share, second_share = first.probability[..., first_mode], second.probability[..., second_mode]
    in_mode = first_share * second_share / prior
    in_others = _rest(first.probability, first_mode) * _rest(second.probability, second_mode) / (1.0 - prior)
    return in_mode / (in_mode + in_others)


def _rest(probability: Floats, mode: int) -> Floats:
    return _sum(np.moveaxis(np.delete(probability, mode, axis=-1), -1, 0))


def innovation_distance(models: ModelSet, mixture: Mixture, measurement: Floats) -> Floats:
    """Return the (N, V) squared Mahalanobis distance of measurements (N, V, p) from a predicted mixture.

    Mean and covariance are those of the mixture's predicted measurement, the spread of the modes included.
    """
    return measurement_distance(predict_measurement(models, mixture), measurement)


@dataclass(frozen=True)
class PredictedMeasurement:
    """Normal law of the measurement (p numbers) of V tracks.

    Attributes:
        centre: (p, V, N) mean.
        inverse: (p, p, V, N) inverse of the covariance.
        log_determinant: (V, N) of the covariance.
    """

    centre: Floats
    inverse: Floats
    log_determinant: Floats


def predict_measurement(models: ModelSet, mixture: Mixture) -> PredictedMeasurement:
    """Return mean and covariance of a predicted mixture's measurement, the spread of the modes included."""
    mean, covariance, probability = _particles_last(mixture)
    p = len(models.measurement_variance)
    centre, spread = _merge(list(probability), mean[:p], covariance[:p, :p])
    noise = np.eye(p)[..., None, None] * models.measurement_variance[:, None, None]
    return PredictedMeasurement(centre, *_invert(spread + noise))


def measurement_distance(predicted: PredictedMeasurement, measurement: Floats) -> Floats:
    """Return the (N, V) squared Mahalanobis distance of measurements (N, V, p)."""
    residual = np.ascontiguousarray(measurement.T) - predicted.centre
    return _sum(residual * _product(predicted.inverse, residual[:, None])[:, 0]).T


def fuse(mixture: Mixture) -> tuple[Floats, Floats]:
    """Return mean (N, V, n) and covariance (N, V, n, n) of the mixture."""
    mean, covariance, probability = _particles_last(mixture)
    centre, spread = _merge(list(probability), mean, covariance)
    return centre.T, spread.T


def forecast(ahead: Horizon, mixture: Mixture) -> Floats:
    """Return the (N, V, H + 1) expected position [m]: the mean over modes that no longer switch."""
    mean, _, probability = _particles_last(mixture)
    total = np.zeros((len(ahead.weight), *probability.shape[1:]))
    for m, chance in enumerate(probability):
        for weight, component in zip(ahead.weight[:, m].T, mean[:, m], strict=True):
            total += weight[:, None, None] * (chance * component)
        total += ahead.offset[:, m, None, None] * chance
    return np.ascontiguousarray(total.T)


def _merge(weights: list[Floats], mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of a mixture; modes are axis 1 of ``mean``, axis 2 of ``covariance``."""
    means = list(mean.swapaxes(0, 1))
    centre = _sum(weight * each for weight, each in zip(weights, means, strict=True))
    spread = np.zeros((len(centre), *centre.shape))
    for m, weight in enumerate(weights):
        gap = means[m] - centre
        term = _outer(gap, gap)
        term += covariance[:, :, m]  # in place: allocating arrays of this size costs more than the arithmetic
        term *= weight
        spread += term
    return centre, spread


def _particles_last(mixture: Mixture) -> tuple[Floats, Floats, Floats]:
    """Return mean (n, M, V, N), covariance (n, n, M, V, N) and probability (M, V, N)."""
    mean, covariance, probability = (
        np.ascontiguousarray(leaf.T) for leaf in (mixture.mean, mixture.covariance, mixture.probability)
    )
    return mean, covariance, probability


def _per_mode(values: Floats) -> Floats:
    return np.moveaxis(values, 0, -1)[..., None, None]  # (..., M, 1, 1)


def _sum(terms: Iterable[Floats]) -> Floats:
    iterator = iter(terms)
    total = next(iterator).copy()
    for term in iterator:
        total += term
    return total


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, None] * b[None]


def _product(a: Floats, b: Floats) -> Floats:
    # over the first two axes: (i, k, ...), (k, j, ...) -> (i, j, ...)
    return _sum(_outer(a[:, k], b[k]) for k in range(len(b)))


def _sandwich(a: Floats, covariance: Floats) -> Floats:
    """Return A P A^T, symmetric to the last bit."""
    product = _product(_product(a, covariance), a.swapaxes(0, 1))
    return 0.5 * (product + product.swapaxes(0, 1))


def _invert(matrix: Floats) -> tuple[Floats, Floats]:
    if len(matrix) == 1:  # symmetric, 1 x 1 or 2 x 2
        return 1.0 / matrix, np.log(matrix[0, 0])
    (a, b), (_, d) = matrix
    determinant = a * d - b * b
    return np.array([[d, -b], [-b, a]]) / determinant, np.log(determinant)


def _posterior(prior: Floats, log_likelihood: Floats) -> Floats:
    log_joint = np.log(prior) + log_likelihood
    joint: Floats = np.exp(log_joint - log_joint.max(axis=0))  # log-sum-exp: an outlier leaves some
    return joint / _sum(joint)
