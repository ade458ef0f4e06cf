"""Errors that last: any model of this plugin, with numbers that are correlated in time.

Each number of a vehicle becomes a Gaussian autoregressive sequence of first order,

    z(0) = xi(0),    z(t) = rho z(t - 1) + sqrt(1 - rho^2) xi(t),    rho = exp(-dt / tau),

of the independent standard normal numbers xi that the particle is handed. Every z(t) is standard normal, so
one observation by itself has exactly the law that it has without, given the world. Numbers that lie s seconds
apart have the correlation exp(-s / tau).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Observation, Scene, World
from avrare_gp_pem.config import Persistence

Floats = NDArray[np.float64]


class Memoryless(Protocol):
    """A model that draws its errors anew at every step."""

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""

    def observe(self, world: World, noise: Floats) -> Observation:
        """One observation of every other vehicle, from noise (N, noise_size)."""


Model = TypeVar("Model", bound=Memoryless)


@dataclass(frozen=True)
class PersistentPem:
    """A model whose errors last (an ``avrare.protocols.PersistentPerceptionErrorModel``).

    It has no ``log_prob``: the density of an observation given all earlier ones is an integral over what
    those do not show of the latent numbers.

    Attributes:
        memoryless: The model of one observation.
        kept: (noise_size,) share rho of each latent number that is left after a step.
        fresh: (noise_size,) sqrt(1 - rho^2), the share of what is drawn.
    """

    memoryless: Memoryless
    kept: Floats
    fresh: Floats

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step, as without."""
        return self.memoryless.noise_size

    def start(self, noise: Floats) -> Floats:
        """Latent numbers (N, noise_size) at t = 0: in the steady state from the beginning."""
        return noise.copy()

    def observe(self, world: World, noise: Floats) -> Observation:
        """One observation without a past, from noise (N, noise_size)."""
        return self.memoryless.observe(world, noise)

    def follow(self, world: World, noise: Floats, memory: Floats) -> tuple[Observation, Floats]:
        """The observation of the next step and its latent numbers, from noise (N, noise_size)."""
        latent = self.kept * memory + self.fresh * noise
        return self.memoryless.observe(world, latent), latent


def lasting(model: Model, persistence: Persistence, scene: Scene) -> Model | PersistentPem:
    """``model`` with errors that last; ``model`` itself where nothing does."""
    channels = (persistence.detection, persistence.position, persistence.position, persistence.speed)
    if not any(channels):
        return model
    seconds = np.tile(np.array(channels), len(scene.names))
    with np.errstate(divide="ignore"):  # none: nothing is kept
        steps = scene.dt / seconds
    return PersistentPem(model, np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps)))
