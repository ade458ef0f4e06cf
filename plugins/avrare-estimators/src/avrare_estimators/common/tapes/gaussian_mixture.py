"""Laws of noise tapes with a known density: the protocol of all, and mixtures of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from avrare.base.errors import UsageError
from avrare.protocols import Floats


@runtime_checkable
class NoiseProposal(Protocol):
    """A law of noise tapes with a known density."""

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw tapes (n, steps + 1, noise_size)."""

    def log_ratio(self, noise: Floats) -> Floats:
        """Return log p/q (n,) of tapes, where p is standard normal."""


@dataclass(frozen=True)
class GaussianMixture:
    """A mixture of K Gaussians of the tape, each with independent entries.

    Attributes:
        share: (K,) adding up to 1.
        mean: (K, steps + 1, noise_size).
        std: (K, steps + 1, noise_size), positive.
    """

    share: Floats
    mean: Floats
    std: Floats

    @staticmethod
    def single(mean: ArrayLike, std: ArrayLike, shape: tuple[int, int]) -> GaussianMixture:
        """Return one Gaussian from numbers or arrays that broadcast to (steps + 1, noise_size).

        Raises:
            UsageError: They do not broadcast, or a standard deviation is not positive.
        """
        arrays = []
        for name, value in (("mean", mean), ("std", std)):
            try:
                array = np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
            except (TypeError, ValueError):
                raise UsageError(
                    f"proposal: {name} does not fit tapes of {shape[0]} rows of {shape[1]} numbers",
                    "give one number, one for each channel, or (steps + 1, noise_size) of them",
                ) from None
            arrays.append(np.array(array)[None])
        if not (np.isfinite(arrays[0]).all() and np.isfinite(arrays[1]).all() and (arrays[1] > 0).all()):
            raise UsageError("proposal: mean must be finite, and std finite and positive")
        return GaussianMixture(np.ones(1), *arrays)

    def sample(self, rng: np.random.Generator, n: int) -> Floats:
        """Draw tapes (n, steps + 1, noise_size)."""
        component = rng.choice(len(self.share), size=n, p=self.share)
        normal = rng.standard_normal((n, *self.mean.shape[1:]))
        return np.asarray(self.mean[component] + self.std[component] * normal)

    def log_ratio(self, noise: Floats) -> Floats:
        """Return log p/q (n,)."""
        logs = np.log(self.share) + self.component_log_ratios(noise)
        return np.asarray(-np.logaddexp.reduce(logs, axis=1))

    def component_log_ratios(self, noise: Floats) -> Floats:
        """Return log q/p (n, K) of each component q."""
        flat = noise.reshape(len(noise), -1)
        columns = []
        for mean, std in zip(self.mean.reshape(len(self.share), -1), self.std, strict=True):
            standard = (flat - mean) / std.reshape(-1)
            columns.append(0.5 * (flat * flat - standard * standard).sum(axis=1) - np.log(std).sum())
        return np.stack(columns, axis=1)
