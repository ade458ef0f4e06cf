"""Perception error models of this plugin: fitted to a detector, in closed form, and naive."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Scene, World
from avrare.driving.values import world_in_plane
from avrare.protocols import Floats
from avrare_gp_pem.config import GpPemConfig, NaivePemConfig, ParametricPemConfig, Persistence
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.features import box_of
from avrare_gp_pem.runtime.ghosts import with_ghosts
from avrare_gp_pem.runtime.motion_errors import MotionErrorPem, with_motion_errors
from avrare_gp_pem.runtime.observation_model import (
    NOISE_PER_VEHICLE,
    ObservationLaw,
    noise_names,
    normal_log_density,
    perfect_noise,
    weather_of,
)
from avrare_gp_pem.runtime.persistence import with_persistence
from avrare_gp_pem.runtime.scaled_law import scale_law, shift_noise
from avrare_gp_pem.runtime.shared_errors import with_shared_errors
from avrare_gp_pem.runtime.store import load, locate
from avrare_gp_pem.runtime.variant import MAX_EXPONENT, FittedPem, Variant
from avrare_gp_pem.runtime.visibility import category, relative, visibility


class LawPem(ABC):
    """Perception error model given by its distribution (an ``avrare.protocols.PerceptionErrorModel``)."""

    scene: Scene

    @abstractmethod
    def law(self, world: World) -> ObservationLaw:
        """Return the distribution of the observation of ``world``."""

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""
        return NOISE_PER_VEHICLE * len(self.scene.names)

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""
        return noise_names(self.scene.names)

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise of an observation without misses and errors."""
        return perfect_noise(self.scene.names)

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""
        return self.law(world).in_weather(weather_of(world)).draw(world, noise)

    def log_prob(self, world: World, observation: Observation) -> Floats:
        """Return the (N,) log density of ``observation``."""
        return self.law(world).in_weather(weather_of(world)).log_prob(world, observation)

    def shift_noise(self, world: World, noise: Floats, other: LawPem) -> tuple[Floats, Floats]:
        """Return the noise with which ``other`` gives the same observations, and log density ratios."""
        law, moved = (model.law(world).in_weather(weather_of(world)) for model in (self, other))
        return shift_noise(law, moved, noise)

    def log_ratio(
        self, world: World, noise: Floats, memory: None, other: LawPem, other_memory: None
    ) -> tuple[Floats, None]:
        """Return (N,) log density ratio of ``other`` for the observation that ``noise`` makes."""
        return self.shift_noise(world, noise, other)[1].sum(axis=1), None


@dataclass(frozen=True)
class GpPem(LawPem):
    """Model fitted to a detector: Gaussian processes or networks.

    Attributes:
        config: Options.
        scene: Sizes of the other vehicles.
        variant: The fitted distribution.
    """

    config: GpPemConfig
    scene: Scene
    variant: Variant

    def law(self, world: World) -> ObservationLaw:
        """Return the distribution of the observation of ``world``."""
        levels = category(visibility(world, self.scene, self.config.rays))
        relative_world = relative(world_in_plane(self.scene.road, world))
        box = box_of(relative_world, self.scene.lengths, self.scene.widths, self.config.height, levels)
        return scale_law(self.variant.law(box, self.config.speed_sd), self.config)


def build_gp(config: GpPemConfig, scene: Scene) -> object:
    """Build the fitted model for a scene.

    Raises:
        UsageError: The model is unknown, its file cannot be read, or it lacks a requested part: the member,
            the artefact, or the persistence, ghosts or headings of its data.
    """
    fitted = _member(load(locate(config.model)), config)
    variant = fitted.delivered if config.artefact else fitted.clean
    if variant is None:
        message = f"perception model {config.model!r} has no artefact of label matching"
        raise UsageError(message, "remove artefact: true")
    ghosts, heading = config.ghosts, config.heading
    if ghosts == "measured" and fitted.ghosts is None:
        message = f"perception model {config.model!r} has no measured ghosts"
        raise UsageError(message, "fit it to data with rows of `ghost` 1, or give their rate and place")
    if heading == "measured" and fitted.yaw is None:
        message = f"perception model {config.model!r} has no measured errors of heading"
        raise UsageError(message, "fit it to data with `error_yaw`, or give flips, scale and dof")
    return _with_options(
        GpPem(config, scene, variant),
        config,
        _persistence(config, fitted),
        fitted.ghosts if ghosts == "measured" else ghosts,
        fitted.yaw if heading == "measured" else heading,
    )


def _with_options(model: Any, config: Any, persistence: Persistence, ghosts: Any, heading: Any) -> object:
    """Return a model with errors of motion, persistence and ghosts, as far as they are wanted."""
    full = with_motion_errors(model, config.speed_y_sd, heading)
    kinds = full.kinds if isinstance(full, MotionErrorPem) else ()
    full = with_persistence(full, persistence, model.scene, kinds)
    full = with_ghosts(full, ghosts, model.scene, config.speed_sd)
    return with_shared_errors(full, config, model.scene)


def _member(fitted: FittedPem, config: GpPemConfig) -> FittedPem:
    if config.member > len(fitted.ensemble):
        count = f"it has {len(fitted.ensemble)}" if fitted.ensemble else "it has none"
        message = f"perception model {config.model!r} has no member {config.member}: {count}"
        raise UsageError(message, "fit it with `avrare pem fit --ensemble K`, or leave member out")
    return fitted.ensemble[config.member - 1] if config.member else fitted


def _persistence(config: GpPemConfig, fitted: FittedPem) -> Persistence:
    if isinstance(config.persistence, Persistence):
        return config.persistence
    if fitted.persistence is None:
        message = f"perception model {config.model!r} has no measured persistence"
        raise UsageError(message, "fit it to data with `track` and `time`, or give time constants")
    (detection, detection_lasting), (position, position_lasting) = (
        fitted.persistence.detection.tolist(),
        fitted.persistence.position.tolist(),
    )
    return Persistence(
        detection=detection,
        position=position,
        detection_lasting=detection_lasting,
        position_lasting=position_lasting,
    )


@dataclass(frozen=True)
class ParametricPem(LawPem):
    """Perception error model in closed form, free of licensed data.

    Detection falls logistically with range; errors are Student-t with a scale that grows with range. The
    default coefficients were fitted to a PointPillar lidar detector on vehicles oblique to the ego, range
    below 60 m.

    Occlusion multiplies detection by min(1, visible fraction / full_visibility): a detector hardly notices a
    little occlusion (on KITTI 0.77 of unoccluded and 0.75 of partly occluded vehicles are detected, 0.63 of
    largely occluded ones), and a vehicle that returns no echo cannot be detected.

    Attributes:
        config: Coefficients.
        scene: Sizes of the other vehicles.
    """

    config: ParametricPemConfig
    scene: Scene

    def law(self, world: World) -> ObservationLaw:
        """Return the distribution of the observation of ``world``."""
        config, distance = self.config, relative(world_in_plane(self.scene.road, world)).range
        reach = np.asarray(config.detection_range)
        if config.weather_range and (weather := weather_of(world)) is not None:
            reach = reach / weather[:, None] ** config.weather_range
        steepness = (distance - reach) / config.detection_width
        in_range = config.detection_plateau / (1 + np.exp(np.minimum(steepness, MAX_EXPONENT)))
        relative_world = visibility(world, self.scene, config.rays)
        detect = in_range * np.minimum(1.0, relative_world / config.full_visibility)
        coefficients = (config.longitudinal_scale, config.lateral_scale)
        scale = np.stack([base + slope * distance for base, slope in coefficients], axis=-1)
        law = ObservationLaw(
            detect=detect,
            miss=1 - detect,
            location=np.zeros_like(scale),
            scale=scale,
            dof=(config.longitudinal_dof, config.lateral_dof),
            limit=config.error_limit,
            speed_sd=config.speed_sd,
        )
        return scale_law(law, config)


def build_parametric(config: ParametricPemConfig, scene: Scene) -> object:
    """Build the parametric model for a scene."""
    model = ParametricPem(config, scene)
    return _with_options(model, config, config.persistence, config.ghosts, config.heading)


@dataclass(frozen=True)
class NaivePem:
    """Model that errs on purpose: the fixed proposal of stl-ams ("Imp-Naive", section IV).

    Each vehicle is missed with a fixed probability, whatever the truth, and the position of a detected one is
    normal around it, along the world's axes. It models no detector: sampling from it makes failures frequent,
    and ``log_prob`` gives the importance weight. Its speed has the distribution of the other models, so that
    this part of the weights cancels.

    Attributes:
        config: Options.
        scene: The observed vehicles.
    """

    config: NaivePemConfig
    scene: Scene

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""
        return NOISE_PER_VEHICLE * len(self.scene.names)

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""
        return noise_names(self.scene.names)

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise of an observation without misses and errors."""
        return perfect_noise(self.scene.names)

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""
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
        """Return the (N,) joint log density of detected, x, y and speed_x of all vehicles."""
        others, config = world.others, self.config
        speed = others.speed * np.cos(others.heading)
        errors = (
            (observation.x - others.x, config.sd),
            (observation.y - others.y, config.sd),
            (observation.speed_x - speed, config.speed_sd),
        )
        seen = np.full(others.x.shape, math.log(config.detection))
        for error, sd in errors:
            seen = seen + normal_log_density(np.where(observation.detected, error, 0.0), sd)
        missed = math.log1p(-config.detection)
        density: Floats = np.where(observation.detected, seen, missed).sum(axis=-1)
        return density


def build_naive(config: NaivePemConfig, scene: Scene) -> object:
    """Build the naive model for a scene."""
    return _with_options(NaivePem(config, scene), config, config.persistence, config.ghosts, config.heading)
