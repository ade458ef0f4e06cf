"""Errors of detections beyond the place: speed across the road, and heading.

A box has a front that the detector guesses: with some probability the reported heading is half a turn off.
The rest of the error is Student-t up to a quarter turn (``variant.YawErrors``), as fitted or as given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Scene, World
from avrare.driving.values import world_in_plane
from avrare.protocols import Floats
from avrare_gp_pem.config import HeadingErrors
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.observation_model import normal_log_density
from avrare_gp_pem.runtime.persistence import check_ratio
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import YawErrors
from avrare_gp_pem.runtime.visibility import relative

_SPEED, _HEADING = ("speed error across",), ("flip of heading", "heading error")


@dataclass(frozen=True)
class MotionErrorPem:
    """Model that also reports speeds across the road, or headings.

    Attributes:
        model: Model of detection, place and speed along the road, which redraws its errors at every step.
        speed_y_sd: Standard deviation of the speed across the road [m/s]; None: not reported.
        heading: Law of the heading's errors; None: not reported.
    """

    model: Any
    speed_y_sd: float | None
    heading: YawErrors | None

    @property
    def scene(self) -> Scene:
        """Sizes of the other vehicles."""
        scene: Scene = self.model.scene
        return scene

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of a vehicle's noise numbers, after those of the model."""
        return (*(_SPEED if self.speed_y_sd is not None else ()), *(_HEADING if self.heading else ()))

    @property
    def noise_size(self) -> int:
        """Standard normal numbers per particle and step."""
        return int(self.model.noise_size) + len(self.kinds) * len(self.scene.names)

    @property
    def noise_names(self) -> tuple[str, ...]:
        """Name of each noise number."""
        motion_names = (f"{kind} of {name}" for name in self.scene.names for kind in self.kinds)
        return (*self.model.noise_names, *motion_names)

    @property
    def perfect_noise(self) -> tuple[float, ...]:
        """Noise of an observation without misses and errors."""
        no_flip = 8.0  # a normal number at which no heading is flipped
        motion_noise = tuple(no_flip if kind == _HEADING[0] else 0.0 for kind in self.kinds)
        return (*self.model.perfect_noise, *(motion_noise * len(self.scene.names)))

    def observe(self, world: World, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""
        observation: Observation = self.model.observe(world, noise[:, : self.model.noise_size])
        parts = dict(zip(self.kinds, self._parts(noise), strict=True))
        others, missing = world.others, np.where(observation.detected, 0.0, np.nan)
        if self.speed_y_sd is not None:
            across = others.speed * np.sin(others.heading) + self.speed_y_sd * parts[_SPEED[0]]
            observation = replace(observation, speed_y=across + missing)
        if self.heading is not None:
            distance = self._range(world)
            flipped = normal.cdf(parts[_HEADING[0]]) < self.heading.flip_probability(distance)
            scale = self.heading.scale[0] + self.heading.scale[1] * distance
            rest = scale * student(float(self.heading.dof)).draw_truncated(
                parts[_HEADING[1]], 0.5 * np.pi / scale
            )
            error = rest + np.where(flipped, np.pi, 0.0)
            observation = replace(observation, heading=_wrap(others.heading - error) + missing)
        return observation

    def log_prob(self, world: World, observation: Observation) -> Floats:
        """Return the (N,) log density of ``observation``."""
        total: Floats = self.model.log_prob(world, observation)
        others, seen = world.others, observation.detected
        if self.speed_y_sd is not None and observation.speed_y is not None:
            error = observation.speed_y - others.speed * np.sin(others.heading)
            density = normal_log_density(np.where(seen, error, 0.0), self.speed_y_sd)
            total = total + np.where(seen, density, 0.0).sum(axis=1)
        if self.heading is not None and observation.heading is not None:
            error = _wrap(np.where(seen, others.heading - observation.heading, 0.0))
            density = self.heading.log_density(error, self._range(world))
            total = total + np.where(seen, density, 0.0).sum(axis=1)
        return total

    def shift_noise(self, world: World, noise: Floats, other: MotionErrorPem) -> tuple[Floats, Floats]:
        """Return the noise with which ``other`` gives the same observations, and log density ratios.

        Raises:
            UsageError: The laws of these errors differ, or the model of the places has no ratio.
        """
        if self.speed_y_sd != other.speed_y_sd or not _same(self.heading, other.heading):
            raise UsageError(
                "no density ratio is known for speed_y_sd and heading", "vary other options of the perception"
            )
        check_ratio(self.model, "shift_noise")
        size = int(self.model.noise_size)
        parts = self.model.shift_noise(world, noise[:, :size], other.model)
        rest = ((0, 0), (0, self.noise_size - size))
        return np.pad(parts[0], rest), np.pad(parts[1], rest)

    def log_ratio(
        self, world: World, noise: Floats, memory: None, other: MotionErrorPem, other_memory: None
    ) -> tuple[Floats, None]:
        """Return (N,) log density ratio of ``other`` for the observation that ``noise`` makes."""
        return self.shift_noise(world, noise, other)[1].sum(axis=1), None

    def _parts(self, noise: Floats) -> tuple[Floats, ...]:
        motion_noise = noise[:, self.model.noise_size :].reshape(
            len(noise), len(self.scene.names), len(self.kinds)
        )
        return tuple(np.moveaxis(motion_noise, -1, 0))

    def _range(self, world: World) -> Floats:
        return relative(world_in_plane(self.scene.road, world)).range


def with_motion_errors(
    model: object, speed_y_sd: float | None, heading: HeadingErrors | YawErrors | None
) -> Any:
    """Return ``model`` with reported speeds across the road and headings; itself where neither is wanted."""
    if speed_y_sd is None and heading is None:
        return model
    if isinstance(heading, HeadingErrors):
        odds = max(heading.flips, 1e-300) / (1.0 - heading.flips)
        heading = YawErrors(np.array([np.log(odds), 0.0]), np.array(heading.scale), np.array(heading.dof))
    return MotionErrorPem(model, speed_y_sd, heading)


def _wrap(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _same(first: YawErrors | None, second: YawErrors | None) -> bool:
    if first is None or second is None:
        return first is second
    return all(np.array_equal(value, getattr(second, name)) for name, value in vars(first).items())
