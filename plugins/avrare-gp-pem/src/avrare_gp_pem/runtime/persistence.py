"""Persistent errors: any model of this plugin with noise that is correlated in time.

Each noise coordinate of a vehicle becomes a Gaussian autoregressive sequence of first order,

    z(0) = xi(0),    z(t) = rho z(t - 1) + sqrt(1 - rho^2) xi(t),    rho = exp(-dt / tau),

of the independent standard normal numbers xi of the particle's noise. Every z(t) is standard normal, so the
distribution of a single observation, given the world, is unchanged. Two numbers s seconds apart have the
correlation exp(-s / tau).

Where a share c of the variance lasts, the number is sqrt(c) u + sqrt(1 - c) y(t) with one u for the whole
rollout, and the correlation is c + (1 - c) exp(-s / tau). Nothing is observed at t = 0, so u is the number
xi(0), and the sequence y begins with y(1) = xi(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Scene, World
from avrare.protocols import Bools, Floats
from avrare_gp_pem.config import Persistence


class MemorylessPem(Protocol):
    """Model whose errors are independent from step to step."""

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise of an observation without misses and errors."""

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""


Model = TypeVar("Model", bound=MemorylessPem)


@dataclass(frozen=True)
class Memory:
    """Latent numbers of N particles.

    Attributes:
        lasting: (N, noise_size) u; 0 where nothing lasts.
        fading: (N, noise_size) y at the newest step.
        begun: (N,) False before the first observation.
    """

    lasting: Floats
    fading: Floats
    begun: Bools


@dataclass(frozen=True)
class PersistentPem:
    """Model with persistent errors.

    It has no ``log_prob``: the density of an observation given all earlier ones is an integral over the part
    of the latent numbers that those do not determine.

    Attributes:
        memoryless: The model of one observation.
        correlation: (noise_size,) rho of each fading number over one step.
        innovation: (noise_size,) sqrt(1 - rho^2), the factor of the new noise.
        lasting: (noise_size,) c, the share of variance that lasts.
    """

    memoryless: MemorylessPem
    correlation: Floats
    innovation: Floats
    lasting: Floats

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step, as without persistence."""
        return self.memoryless.noise_size

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number: what it adds to an error that lasts."""
        return self.memoryless.noise_names

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise without misses and errors, at every step."""
        return self.memoryless.perfect_noise

    def start(self, noise: Floats) -> Memory:
        """Return the latent numbers at t = 0, in the stationary state, from noise (N, noise_size)."""
        lasts = self.lasting > 0
        return Memory(np.where(lasts, noise, 0.0), np.where(lasts, 0.0, noise), np.zeros(len(noise), bool))

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation without a past, from noise (N, noise_size)."""
        return self.memoryless.observe(world, noise)

    def follow(self, world: World, noise: Floats, memory: Memory) -> tuple[Observation, Memory]:
        """Return the observation of the next step and its latent numbers, from noise (N, noise_size)."""
        fresh = (self.lasting > 0) & ~memory.begun[:, None]  # its y(0) was never drawn
        fading = np.where(fresh, noise, self.correlation * memory.fading + self.innovation * noise)
        later = Memory(memory.lasting, fading, np.ones_like(memory.begun))
        return self.memoryless.observe(world, self.latent(later)), later

    def log_ratio(
        self, world: World, noise: Floats, memory: Memory, other: PersistentPem, other_memory: Memory
    ) -> tuple[Floats, Memory]:
        """Return (N,) log density ratio of another model for the observation from ``noise``.

        The tape of ``other`` that gives the same observations is a function of this one's, number by number
        and step by step, so the ratio of the densities of the two tapes times its derivative weighs this tape
        for ``other``, however far it is. ``other_memory`` is that tape's, and is returned one step on.
        """
        _, later = self.follow(world, noise, memory)
        latent = self.latent(later)
        model: Any = self.memoryless
        check_ratio(model, "shift_noise")
        change, ratio = model.shift_noise(world, latent, other.memoryless)
        moved = latent + change
        fading = (moved - np.sqrt(other.lasting) * other_memory.lasting) / np.sqrt(1.0 - other.lasting)
        own_fresh = (self.lasting > 0) & ~memory.begun[:, None]
        fresh = (other.lasting > 0) & ~other_memory.begun[:, None]
        drawn = np.where(fresh, fading, (fading - other.correlation * other_memory.fading) / other.innovation)
        spread = np.where(own_fresh, 1.0, self.innovation) * np.sqrt(1.0 - self.lasting)
        other_spread = np.where(fresh, 1.0, other.innovation) * np.sqrt(1.0 - other.lasting)
        squares = noise**2 - drawn**2 + moved**2 - latent**2
        total = ratio + 0.5 * squares + np.log(spread / other_spread)
        return total.sum(axis=1), Memory(other_memory.lasting, fading, np.ones_like(other_memory.begun))

    def latent(self, memory: Memory) -> Floats:
        """Return the standard normal numbers (N, noise_size) that decide the newest observation."""
        return np.sqrt(self.lasting) * memory.lasting + np.sqrt(1.0 - self.lasting) * memory.fading


def check_ratio(model: object, method: str) -> None:
    """Raise a ``UsageError`` if a model lacks the method for its density ratio."""
    if not hasattr(model, method):
        raise UsageError(f"{type(model).__name__} has no density ratio", "choose parametric or gp_pem")


def with_persistence(
    model: Model, persistence: Persistence, scene: Scene, kinds: tuple[str, ...] = ()
) -> Model | PersistentPem:
    """Return ``model`` with persistent errors; ``model`` itself if no error persists.

    ``kinds`` are those of a ``MotionErrorPem``.
    """
    channels = (persistence.detection, persistence.position, persistence.position, persistence.speed)
    shares = (persistence.detection_lasting, persistence.position_lasting, persistence.position_lasting, 0.0)
    further = tuple(persistence.heading if "heading" in kind else persistence.speed for kind in kinds)
    if not any((*channels, *shares, *further)):
        return model
    seconds, lasting = (
        np.concatenate([np.tile(np.array(part), len(scene.names)) for part in parts])
        for parts in ((channels, further), (shares, (0.0,) * len(kinds)))
    )
    with np.errstate(divide="ignore"):  # a time constant of 0 gives a correlation of 0
        steps = scene.dt / seconds
    return PersistentPem(model, np.exp(-steps), np.sqrt(-np.expm1(-2.0 * steps)), lasting)
