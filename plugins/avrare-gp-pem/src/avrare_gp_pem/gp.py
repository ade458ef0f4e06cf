"""Sparse variational Gaussian processes: prediction in NumPy from exported arrays.

With whitened q(u) = N(m, S S^T) and w = L^-1 k(Z, x), where L L^T = k(Z, Z), the latent functions at x have
mean prior(x) + w^T m and variance k(x, x) - |w|^2 + |S^T w|^2. All matrices that meet x are multiplied out
once, so that a prediction is one matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# A row must have the same last bits in any batch and place. So products have one shape, and both its sides
# are whole numbers of the tiles of every common BLAS kernel: a part of a tile is summed in another order.
_BLOCK = 48
_TILE = 64
_TOGETHER = 8
"""Blocks that one stacked product takes: what they need stays in the cache."""


@dataclass(frozen=True)
class SparseGp:
    """L latent functions of D inputs that share a kernel and M inducing points. All arrays are read-only.

    Attributes:
        inducing: (M, D) inducing points Z, in normalised inputs.
        lengthscale: (D,) of the squared-exponential kernel.
        variance: () of the kernel.
        location: (L, M) whitened variational mean m.
        factor: (L, M, M) whitened variational factor S, lower triangular.
        prior: (L, 2) prior mean: constant and slope over the first input.
        jitter: () added to the diagonal of k(Z, Z).
        projection: (M, L + M + L M and padding) what k(Z, x) is multiplied by; see ``sparse_gp``.
    """

    inducing: Floats
    lengthscale: Floats
    variance: Floats
    location: Floats
    factor: Floats
    prior: Floats
    jitter: Floats
    projection: Floats

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Mean and variance of the latent functions.

        Args:
            x: (n, D) normalised inputs.

        Returns:
            (n, L) means and (n, L) variances; a row depends on its own input only, to the last bit.
        """
        count, latents = len(x), len(self.prior)
        blocks = np.zeros((-(-count // _BLOCK), _BLOCK, x.shape[1]))
        blocks.reshape(-1, x.shape[1])[:count] = x
        moments = np.empty((2, *blocks.shape[:2], latents))
        for i in range(0, len(blocks), _TOGETHER):
            part = slice(i, i + _TOGETHER)
            moments[0, part], moments[1, part] = self._blocks(blocks[part])
        mean, variance = moments.reshape(2, -1, latents)[:, :count]
        return mean, variance

    def _blocks(self, x: Floats) -> tuple[Floats, Floats]:
        latents, points = self.location.shape
        product = self._kernel(x) @ self.projection
        mean = product[..., :latents] + self.prior[:, 0] + x[..., :1] * self.prior[:, 1]
        whitened = product[..., latents : latents + (latents + 1) * points]
        whitened = whitened.reshape(*x.shape[:2], latents + 1, points)
        explained = np.einsum("...m,...m->...", whitened, whitened)
        return mean, np.maximum(self.variance - explained[..., :1] + explained[..., 1:], 0.0)

    def _kernel(self, x: Floats) -> Floats:
        """k(x, Z) of (b, _BLOCK, D) inputs, from |x|^2 - 2 x.z + |z|^2."""
        scaled, points = x / self.lengthscale, self.inducing / self.lengthscale
        size = np.einsum("...d,...d->...", scaled, scaled)[..., None]
        exponent = scaled @ points.T
        exponent -= 0.5 * size
        exponent -= 0.5 * (points * points).sum(axis=1)
        np.exp(np.minimum(exponent, 0.0, out=exponent), out=exponent)
        exponent *= self.variance
        return exponent


def sparse_gp(
    inducing: Floats,
    lengthscale: Floats,
    variance: Floats,
    location: Floats,
    factor: Floats,
    prior: Floats,
    jitter: Floats,
) -> SparseGp:
    """The process of these parameters (see ``SparseGp``); works out its projection [A, L^-T, L^-T S]."""
    scaled = inducing / lengthscale
    squared = ((scaled[:, None, :] - scaled[None, :, :]) ** 2).sum(axis=-1)
    covariance = variance * np.exp(-0.5 * squared) + jitter * np.eye(len(inducing))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance)).T  # L^-T
    parts = [whiten @ location.T, whiten, *(whiten @ part for part in factor)]
    missing = -sum(part.shape[1] for part in parts) % _TILE
    projection = np.concatenate([*parts, np.zeros((len(inducing), missing))], axis=1)
    return SparseGp(inducing, lengthscale, variance, location, factor, prior, jitter, projection)
