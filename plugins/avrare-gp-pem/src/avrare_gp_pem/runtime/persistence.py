"""Persistent errors: any model of this plugin with noise that is correlated in time.

Each noise coordinate of a vehicle becomes a Gaussian autoregressive sequence of first order,

    z(0) = xi(0),    z(t) = rho z(t - 1) + sqrt(1 - rho^2) xi(t),    rho = exp(-dt / tau),

of the independent standard normal numbers xi of the particle's noise. Every z(t) is standard normal, so the
distribution of a single observation, given the world, is unchanged. Two numbers s seconds apart have the
correlation exp(-s / tau).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from avrare.driving import Observation, Scene, World
from avrare.protocols import Floats
from avrare_gp_pem.config import Persistence


class MemorylessPem(Protocol):
    """Model that draws its errors anew at every step."""

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""


Model = TypeVar("Model", bound=MemorylessPem)


@dataclass(frozen=True)
class PersistentPem:
    """Model with persistent errors (an ``avrare.protocols.PersistentPerceptionErrorModel``).

    It has no ``log_prob``: the density of an observation given all earlier ones is an integral over the part
    of the latent numbers that those do not determine.

    Attributes:
        memoryless: The model of one observation.
        correlation: (noise_size,) rho of each latent number over one step.
        innovation: (noise_size,) sqrt(1 - rho^2), the factor of the new noise.
    """

    memoryless: MemorylessPem
    correlation: Floats
    innovation: Floats

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step, as without persistence."""
        return self.memoryless.noise_size

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number: what it adds to an error that lasts."""
        return self.memoryless.noise_names

    def start(self, noise: Floats) -> Floats:
        """Return the latent numbers (N, noise_size) at t = 0, in the stationary state."""
        return noise.copy()

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation without a past, from noise (N, noise_size)."""
        return self.memoryless.observe(world, noise)

    def follow(self, world: World, noise: Floats, memory: Floats) -> tuple[Observation, Floats]:
        """Return the observation of the next step and its latent numbers, from noise (N, noise_size)."""
        latent = self.correlation * memory + self.innovation * noise
        return self.memoryless.observe(world, latent), latent


def with_persistence(model: Model, persistence: Persistence, scene: Scene) -> Model | PersistentPem:
    """Return ``model`` with persistent errors; ``model`` itself where all time constants are 0."""
    channels = (persistence.detection, persistence.position, persistence.position, persistence.speed)
    if not any(channels):
        return model
    seconds = np.tile(np.array(channels), len(scene.names))
    with np.errstate(divide="ignore"):  # a time constant of 0 gives a correlation of 0
        steps = scene.dt / seconds
    return PersistentPem(model, np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps)))
