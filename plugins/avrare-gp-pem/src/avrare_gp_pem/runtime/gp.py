"""Sparse variational Gaussian processes: prediction in NumPy from exported arrays.

With whitened q(u) = N(m, S S^T) and w = L^-1 k(Z, x), where L L^T = k(Z, Z), the latent functions at x have
mean prior(x) + w^T m and variance k(x, x) - |w|^2 + |S^T w|^2. All matrices that multiply a function of x are
combined once, so that a prediction is one matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare_gp_pem.runtime.blocks import evaluate_in_blocks, pad_columns

Singles = NDArray[np.float32]

_TILE, _SINGLE_TILE = 64, 8
_TOGETHER = 48


@dataclass(frozen=True)
class _Process:
    """L latent functions of D inputs that share a kernel and M inducing points.

    Attributes:
        inducing: (M, D) inducing points Z, in normalised inputs.
        lengthscale: (D,) of the squared-exponential kernel.
        variance: Variance of the kernel.
        location: (L, M) whitened variational mean m.
        factor: Whitened variational factor S: (L, M, M) lower triangular, or (L, M) its diagonals.
        prior: (L, 2) prior mean: constant and slope over the first input.
        jitter: Number added to the diagonal of k(Z, Z).
    """

    inducing: Floats
    lengthscale: Floats
    variance: Floats
    location: Floats
    factor: Floats
    prior: Floats
    jitter: Floats

    @cached_property
    def _inverse_factor(self) -> Floats:
        scaled = self.inducing / self.lengthscale
        squared = ((scaled[:, None, :] - scaled[None, :, :]) ** 2).sum(axis=-1)
        covariance = self.variance * np.exp(-0.5 * squared) + self.jitter * np.eye(len(self.inducing))
        return np.linalg.inv(np.linalg.cholesky(covariance)).T  # L^-T


class SparseGp(_Process):
    """Process with full factors S."""

    @cached_property
    def _projection(self) -> Floats:  # [A, L^-T, L^-T S], A giving the mean
        whiten = self._inverse_factor
        parts = [whiten @ self.location.T, whiten, *(whiten @ part for part in self.factor)]
        return pad_columns(np.concatenate(parts, axis=1), _TILE)

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return mean and variance of the latent functions.

        Args:
            x: (n, D) normalised inputs.

        Returns:
            (n, L) means and (n, L) variances; a row depends on its own input only, to the last bit.
        """
        latents = len(self.prior)
        moments = evaluate_in_blocks(self._moments, x, 2 * latents, _TOGETHER)
        return moments[:, :latents], moments[:, latents:]

    def _moments(self, x: Floats) -> Floats:
        latents, points = self.location.shape
        product = self._kernel(x) @ self._projection
        mean = product[..., :latents] + self.prior[:, 0] + x[..., :1] * self.prior[:, 1]
        whitened = product[..., latents : latents + (latents + 1) * points]
        whitened = whitened.reshape(*x.shape[:2], latents + 1, points)
        explained = np.einsum("...m,...m->...", whitened, whitened)
        variance = np.maximum(self.variance - explained[..., :1] + explained[..., 1:], 0.0)
        return np.concatenate([mean, variance], axis=-1)

    def _kernel(self, x: Floats) -> Floats:
        scaled, points = x / self.lengthscale, self.inducing / self.lengthscale
        size = np.einsum("...d,...d->...", scaled, scaled)[..., None]
        exponent = scaled @ points.T
        exponent -= 0.5 * size
        exponent -= 0.5 * (points * points).sum(axis=1)
        np.exp(np.minimum(exponent, 0.0, out=exponent), out=exponent)
        exponent *= self.variance
        return exponent


class DiagonalGp(_Process):
    """Process with diagonal factors S: three times as fast as ``SparseGp``.

    |w|^2 - |S^T w|^2 = sum_j (1 - s_j^2) w_j^2, so no latent function needs a large product of its own. It is
    evaluated in single precision, which moves the latents by less than 1e-4, and the exponent -|x - z|^2 / 2
    of the kernel is one product, of (x, -|x|^2 / 2, 1) and (z, 1, -|z|^2 / 2).
    """

    @cached_property
    def _points(self) -> Singles:
        scaled = self.inducing / self.lengthscale
        ones, sizes = np.ones(len(scaled)), -0.5 * (scaled * scaled).sum(axis=1)
        return _singles(np.vstack([scaled.T, ones, sizes]))

    @cached_property
    def _projection(self) -> Singles:
        whiten = self._inverse_factor
        projection = _singles(self.variance * np.concatenate([whiten, whiten @ self.location.T], axis=1))
        missing = self._points.shape[1] - len(whiten)  # the kernel of a padded point is 1, its factor 0
        return np.pad(projection, ((0, missing), (0, 0)))

    @cached_property
    def _remaining(self) -> Singles:  # 1 - s^2
        return _singles(1.0 - self.factor.T * self.factor.T)

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return mean and variance of the latent functions; see ``SparseGp.predict``."""
        inputs, latents = x.shape[1], len(self.prior)
        augmented, scaled = np.empty((len(x), inputs + 2), np.float32), x / self.lengthscale
        augmented[:, :inputs], augmented[:, inputs + 1] = scaled, 1.0
        augmented[:, inputs] = -0.5 * np.einsum("nd,nd->n", scaled, scaled)
        moments = evaluate_in_blocks(self._moments, augmented, 2 * latents, _TOGETHER)
        mean = moments[:, :latents] + (self.prior[:, 0] + x[:, :1] * self.prior[:, 1])
        return mean, np.maximum(self.variance - moments[:, latents:], 0.0)

    def _moments(self, augmented: Singles) -> Singles:
        latents, points = self.location.shape
        kernel = augmented @ self._points
        np.exp(np.minimum(kernel, 0.0, out=kernel), out=kernel)
        product = kernel @ self._projection
        whitened = product[..., :points]
        explained = (whitened * whitened) @ self._remaining
        return np.concatenate([product[..., points : points + latents], explained[..., :latents]], axis=-1)


def _singles(array: Floats) -> Singles:
    return pad_columns(array, _SINGLE_TILE).astype(np.float32)


@dataclass(frozen=True)
class GpPair:
    """Two processes that are fitted separately and predict together (a ``variant.Latents``).

    Attributes:
        detection: One latent function.
        error: Four latent functions: location of both errors, log scale of both.
    """

    detection: SparseGp | DiagonalGp
    error: SparseGp | DiagonalGp

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return (n, 5) means and variances at normalised inputs (n, D)."""
        parts = zip(self.detection.predict(x), self.error.predict(x), strict=True)
        mean, variance = (np.concatenate(pair, axis=1) for pair in parts)
        return mean, variance


@dataclass(frozen=True)
class NormalErrorGps:
    """Classifier and regressor, the latter with normal noise that is the same everywhere.

    Attributes:
        detection: One latent function.
        error: Two latent functions, the locations of both errors.
        log_noise: (2,) log of the noise's standard deviation, in units of the base scale.
    """

    detection: SparseGp | DiagonalGp
    error: SparseGp | DiagonalGp
    log_noise: Floats

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return (n, 5) means and variances at normalised inputs (n, D); see ``variant.Latents``."""
        parts = zip(self.detection.predict(x), self.error.predict(x), strict=True)
        mean, variance = (np.concatenate(pair, axis=1) for pair in parts)
        noise = np.broadcast_to(self.log_noise, (len(x), len(self.log_noise)))
        return np.concatenate([mean, noise], axis=1), np.pad(variance, ((0, 0), (0, noise.shape[1])))
