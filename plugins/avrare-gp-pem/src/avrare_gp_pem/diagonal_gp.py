"""Sparse variational Gaussian processes with diagonal factors: a third of the time of ``gp.py``.

With the notation of ``gp.py`` and a diagonal S, |w|^2 - |S^T w|^2 = sum_j (1 - s_j^2) w_j^2: no latent
function needs a large product of its own. Everything is in single precision (latents move by less than 1e-4),
and the exponent -|x - z|^2 / 2 of the kernel is one product, of (x, -|x|^2 / 2, 1) and (z, 1, -|z|^2 / 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.gp import SparseGp

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
_BLOCK, _TILE, _TOGETHER = 48, 8, 8  # see gp.py


@dataclass(frozen=True)
class DiagonalGp:
    """L latent functions of D inputs that share a kernel and M inducing points. All arrays are read-only.

    Attributes:
        inducing: (M, D) inducing points Z, in normalised inputs.
        lengthscale: (D,) of the squared-exponential kernel.
        variance: () of the kernel.
        location: (L, M) whitened variational mean m.
        factor: (L, M) diagonals of the whitened variational factor S.
        prior: (L, 2) prior mean: constant and slope over the first input.
        jitter: () added to the diagonal of k(Z, Z).
        points: (D + 2, M and padding) what (x, -|x|^2 / 2, 1) is multiplied by.
        projection: (M and padding, M + L and padding) what the kernel over its variance is multiplied by.
        remaining: (M, L and padding) 1 - s^2.
    """

    inducing: Floats
    lengthscale: Floats
    variance: Floats
    location: Floats
    factor: Floats
    prior: Floats
    jitter: Floats
    points: Singles
    projection: Singles
    remaining: Singles

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Mean and variance of the latent functions.

        Args:
            x: (n, D) normalised inputs.

        Returns:
            (n, L) means and (n, L) variances; a row depends on its own input only, to the last bit.
        """
        (count, inputs), latents = x.shape, len(self.prior)
        blocks = np.zeros((-(-count // _BLOCK), _BLOCK, inputs + 2), np.float32)
        rows = blocks.reshape(-1, inputs + 2)[:count]
        scaled = x / self.lengthscale
        rows[:, :inputs], rows[:, inputs + 1] = scaled, 1.0
        rows[:, inputs] = -0.5 * np.einsum("nd,nd->n", scaled, scaled)
        moments = np.empty((2, *blocks.shape[:2], latents))
        for i in range(0, len(blocks), _TOGETHER):
            part = slice(i, i + _TOGETHER)
            moments[0, part], moments[1, part] = self._blocks(blocks[part])
        mean, explained = moments.reshape(2, -1, latents)[:, :count]
        mean += self.prior[:, 0] + x[:, :1] * self.prior[:, 1]
        return mean, np.maximum(self.variance - explained, 0.0)

    def _blocks(self, augmented: Singles) -> tuple[NDArray[Any], NDArray[Any]]:
        """Mean without the prior's, and what the data explain of the variance."""
        latents, points = self.location.shape
        kernel = augmented @ self.points
        np.exp(np.minimum(kernel, 0.0, out=kernel), out=kernel)
        product = kernel @ self.projection
        whitened = product[..., :points]
        explained = (whitened * whitened) @ self.remaining
        return product[..., points : points + latents], explained[..., :latents]


def diagonal_gp(
    inducing: Floats,
    lengthscale: Floats,
    variance: Floats,
    location: Floats,
    factor: Floats,
    prior: Floats,
    jitter: Floats,
) -> DiagonalGp:
    """The process of these parameters (see ``DiagonalGp``)."""
    scaled = inducing / lengthscale
    squared = ((scaled[:, None, :] - scaled[None, :, :]) ** 2).sum(axis=-1)
    covariance = variance * np.exp(-0.5 * squared) + jitter * np.eye(len(inducing))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance)).T  # L^-T
    ones, sizes = np.ones(len(inducing)), -0.5 * (scaled * scaled).sum(axis=1)
    points = _columns(np.vstack([scaled.T, ones, sizes]))
    projection = _columns(variance * np.concatenate([whiten, whiten @ location.T], axis=1))
    missing = points.shape[1] - len(inducing)  # the kernel of a padded point is 1: it counts for nothing
    return DiagonalGp(
        inducing,
        lengthscale,
        variance,
        location,
        factor,
        prior,
        jitter,
        points,
        np.pad(projection, ((0, missing), (0, 0))),
        _columns(1.0 - factor.T * factor.T),
    )


def _columns(array: Floats) -> Singles:
    """In single precision, with columns of zeros up to a whole number of tiles."""
    return np.pad(array, ((0, 0), (0, -array.shape[1] % _TILE))).astype(np.float32)


@dataclass(frozen=True)
class GpPair:
    """Two processes that are fitted apart and predict together (a ``variant.Latents``).

    Attributes:
        detection: One latent function.
        error: Four: location of both errors, log scale of both.
    """

    detection: SparseGp | DiagonalGp
    error: SparseGp | DiagonalGp

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """(n, 5) means and variances at normalised inputs (n, D)."""
        parts = zip(self.detection.predict(x), self.error.predict(x), strict=True)
        mean, variance = (np.concatenate(pair, axis=1) for pair in parts)
        return mean, variance
