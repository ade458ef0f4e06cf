"""Distribution of one observation, shared by all models: how it is drawn from noise, and its density.

Per vehicle: detected or missed, then an error along and across its body (the axes along which a detector's
errors are independent; labels as delivered have errors to the right of the ego and forward), each Student-t
with its own location and scale, then a normal error of its speed. Errors are truth minus estimate, as in the
training data, so an observation is truth minus error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.driving import Observation, World
from avrare.protocols import Floats
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.student_t import student

NOISE_PER_VEHICLE = 4
"""Detection, error along, error across, speed."""


def noise_names(vehicles: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the noise numbers of an observation of these vehicles."""
    kinds = ("detection", "longitudinal error", "lateral error", "speed error")
    return tuple(f"{kind} of {vehicle}" for vehicle in vehicles for kind in kinds)


def perfect_noise(vehicles: Sequence[str]) -> tuple[float, ...]:
    """Return the noise of an observation without misses and errors of these vehicles.

    Only a vehicle whose probability of detection is below that of a normal number under -8 stays unseen.
    """
    return (-8.0, 0.0, 0.0, 0.0) * len(vehicles)


@dataclass(frozen=True)
class ObservationLaw:
    """Distribution of the observation of N worlds.

    Attributes:
        detect: (N, V) probability of a detection.
        miss: (N, V) probability of a miss; stored because 1 - detect loses a small one.
        location: (N, V, 2) centre of the error along and across the vehicle [m].
        scale: (N, V, 2) Student-t scale of the error [m].
        dof: Degrees of freedom along and across.
        limit: Largest distance of an error from its centre [m].
        speed_sd: Standard deviation of the observed speed [m/s].
        in_ego_frame: The two errors are to the right of the ego and forward, not along and across the
            vehicle.
        power: (N, V, 2) powers of the tails, see ``student_t``; None: all 1, plain Student-t.
    """

    detect: Floats
    miss: Floats
    location: Floats
    scale: Floats
    dof: tuple[float, float]
    limit: float
    speed_sd: float
    in_ego_frame: bool = False
    power: Floats | None = None

    def in_weather(self, factor: Floats | None) -> ObservationLaw:
        """Return the distribution with errors and odds of a miss this many times as large; None: the same."""
        if factor is None:
            return self
        times = factor[:, None]
        total = self.detect + times * self.miss
        scale = self.scale * times[..., None]
        return replace(self, detect=self.detect / total, miss=times * self.miss / total, scale=scale)

    def draw(self, world: World, noise: Floats) -> Observation:
        """Map standard normal noise (N, 4 V) to an observation.

        A vehicle is detected where the rank of its first number is below the probability of detection.
        """
        particles, vehicles = self.detect.shape
        if noise.shape != (particles, NOISE_PER_VEHICLE * vehicles):
            raise ValueError(
                f"the noise has shape {noise.shape}, not {(particles, NOISE_PER_VEHICLE * vehicles)}"
            )
        parts = noise.reshape(particles, vehicles, NOISE_PER_VEHICLE)
        detected = normal.cdf(parts[..., 0]) < self.detect
        along, across = (self._error(axis, parts[..., 1 + axis]) for axis in (0, 1))
        others = world.others
        heading_cos, (cos, sin) = np.cos(others.heading), self._compute_first_axis(world)
        missing = np.where(detected, 0.0, np.nan)
        return Observation(
            detected=detected,
            x=others.x - (cos * along - sin * across) + missing,
            y=others.y - (sin * along + cos * across) + missing,
            speed_x=others.speed * heading_cos + self.speed_sd * parts[..., 3] + missing,
        )

    def log_prob(self, world: World, observation: Observation) -> Floats:
        """Return the (N,) joint log density of detected, x, y and speed_x of all vehicles."""
        others = world.others
        heading_cos, (cos, sin) = np.cos(others.heading), self._compute_first_axis(world)
        dx = np.where(observation.detected, others.x - observation.x, 0.0)
        dy = np.where(observation.detected, others.y - observation.y, 0.0)
        speed = np.where(observation.detected, observation.speed_x - others.speed * heading_cos, 0.0)
        with np.errstate(divide="ignore"):  # an impossible outcome has log probability -inf
            seen = np.log(self.detect) + normal_log_density(speed, self.speed_sd)
            missed = np.log(self.miss)
        errors = (cos * dx + sin * dy, cos * dy - sin * dx)
        for axis, error in enumerate(errors):
            seen = seen + self._error_log_density(axis, error)
        density: Floats = np.where(observation.detected, seen, missed).sum(axis=-1)
        return density

    def _compute_first_axis(self, world: World) -> tuple[Floats, Floats]:
        if self.in_ego_frame:  # to the right, then forward
            cos, sin = np.cos(world.ego.heading)[:, None], np.sin(world.ego.heading)[:, None]
            return sin, -cos
        return np.cos(world.others.heading), np.sin(world.others.heading)

    def _error(self, axis: int, noise: Floats) -> Floats:
        scale = self.scale[..., axis]
        power = 1.0 if self.power is None else self.power[..., axis]
        standard = student(self.dof[axis]).draw_truncated(noise, self.limit / scale, power)
        return self.location[..., axis] + scale * standard

    def _error_log_density(self, axis: int, error: Floats) -> Floats:
        scale = self.scale[..., axis]
        standard = (error - self.location[..., axis]) / scale
        power = None if self.power is None else self.power[..., axis]
        density = student(self.dof[axis]).truncated_log_density(standard, self.limit / scale, power)
        return density - np.log(scale)


def normal_log_density(error: Floats, sd: float) -> Floats:
    """Return the normal log density; where ``sd`` is 0, 0 for an error of 0 and -inf for any other."""
    if sd == 0:
        return np.where(error == 0, 0.0, -np.inf)
    standard = error / sd
    return -0.5 * standard * standard - math.log(sd * math.sqrt(2 * math.pi))


def weather_of(world: World) -> Floats | None:
    """Return the (N,) weather of a world, None where its simulator has no weather."""
    return getattr(world, "weather", None)
