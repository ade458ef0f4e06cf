"""A perception model that errs on purpose: the fixed proposal of stl-ams ("Imp-Naive", section IV).

Each vehicle is missed with probability one half, whatever the truth, and the position of a detected one is
normal around it. It is no model of any detector: it is drawn from so that failures are frequent, and its
``log_prob`` says by how much. Its speed has the law of the other models, so that this part of the weights
cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Observation, Scene, World
from avrare_gp_pem import normal
from avrare_gp_pem.config import NaivePemConfig
from avrare_gp_pem.law import NOISE_PER_VEHICLE
from avrare_gp_pem.persistence import PersistentPem, lasting

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class NaivePem:
    """Detections by the toss of a coin, normal errors along the world's axes.

    Attributes:
        config: Options.
        scene: Whose vehicles are observed.
    """

    config: NaivePemConfig
    scene: Scene

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""
        return NOISE_PER_VEHICLE * len(self.scene.names)

    def observe(self, world: World, noise: Floats) -> Observation:
        """One observation of every other vehicle, from noise (N, noise_size)."""
        others = world.others
        parts = noise.reshape(*others.x.shape, NOISE_PER_VEHICLE)
        detected = normal.cdf(parts[..., 0]) < self.config.detection
        missing = np.where(detected, 0.0, np.nan)
        speed = others.speed * np.cos(others.heading)
        return Observation(
            detected=detected,
            x=others.x + self.config.sd * parts[..., 1] + missing,
            y=others.y + self.config.sd * parts[..., 2] + missing,
            speed_x=speed + self.config.speed_sd * parts[..., 3] + missing,
        )

    def log_prob(self, world: World, observation: Observation) -> Floats:
        """(N,) log density of an observation: of detected, x, y and speed_x of all vehicles together."""
        others, config = world.others, self.config
        speed = others.speed * np.cos(others.heading)
        errors = (
            (observation.x - others.x, config.sd),
            (observation.y - others.y, config.sd),
            (observation.speed_x - speed, config.speed_sd),
        )
        seen = np.full(others.x.shape, math.log(config.detection))
        for error, sd in errors:
            seen = seen + _log_density(np.where(observation.detected, error, 0.0), sd)
        missed = math.log1p(-config.detection)
        return np.where(observation.detected, seen, missed).sum(axis=-1)  # type: ignore[no-any-return]


def _log_density(error: Floats, sd: float) -> Floats:
    """Normal log density; where ``sd`` is 0, that of certainty, as the other models have it."""
    if sd == 0:
        return np.where(error == 0, 0.0, -np.inf)
    standard = error / sd
    return -0.5 * standard * standard - math.log(sd * math.sqrt(2 * math.pi))


def build_naive(config: NaivePemConfig, scene: Scene) -> NaivePem | PersistentPem:
    """The naive model for a scene."""
    return lasting(NaivePem(config, scene), config.persistence, scene)
