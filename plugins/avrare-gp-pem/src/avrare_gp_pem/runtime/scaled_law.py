"""Better and worse detectors: a law of observations with scaled misses, errors and tails.

It also tells by how much the noise would have to move for another law to give the same observation, and the
ratio of their densities. Both are what a score-function derivative of a failure probability needs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.observation_model import NOISE_PER_VEHICLE, ObservationLaw
from avrare_gp_pem.runtime.student_t import student

_INV_SQRT_2PI = 0.3989422804014327


class Scales(Protocol):
    """Options of a model that scale its law."""

    @property
    def miss_scale(self) -> float: ...  # noqa: D102

    @property
    def error_scale(self) -> float: ...  # noqa: D102

    @property
    def tail_scale(self) -> float: ...  # noqa: D102


def scale_law(law: ObservationLaw, scales: Scales) -> ObservationLaw:
    """Return a law with scaled odds of a miss, scales of the errors, and powers of their tails."""
    miss, error, tail = scales.miss_scale, scales.error_scale, scales.tail_scale
    if miss != 1.0:
        total = law.detect + miss * law.miss
        law = replace(law, detect=law.detect / total, miss=miss * law.miss / total)
    if error != 1.0:
        law = replace(law, scale=error * law.scale)
    if tail != 1.0:
        power = np.ones_like(law.scale) if law.power is None else law.power
        law = replace(law, power=tail * power)
    return law


def shift_noise(own: ObservationLaw, other: ObservationLaw, noise: Floats) -> tuple[Floats, Floats]:
    """Return how noise (N, 4 V) of ``own`` moves for a nearby law to give the same observation.

    Returns:
        Changes (N, 4 V), to first order in the difference of the laws, and the logs of the ratio of the
        densities ``other`` / ``own`` of what each number decides. Errors of a missed vehicle decide nothing.
    """
    parts = noise.reshape(*own.detect.shape, NOISE_PER_VEHICLE)
    change, ratio = np.zeros_like(parts), np.zeros_like(parts)
    rank, density = normal.cdf(parts), _INV_SQRT_2PI * np.exp(-0.5 * parts * parts)
    seen = rank[..., 0] < own.detect
    with np.errstate(divide="ignore", invalid="ignore"):
        log_ratio = np.where(seen, np.log(other.detect / own.detect), np.log(other.miss / own.miss))
    moved = np.where(seen, rank[..., 0], -normal.cdf(-parts[..., 0])) * np.expm1(log_ratio)
    ratio[..., 0], change[..., 0] = log_ratio, _divide(moved, density[..., 0])
    for axis in (0, 1):
        z = parts[..., 1 + axis]
        error = own._error(axis, z)
        before, after = (_tail(law, axis, error) for law in (own, other))
        change[..., 1 + axis] = np.where(
            seen, _divide(-np.sign(z) * (after - before), density[..., 1 + axis]), 0.0
        )
        ratio[..., 1 + axis] = np.where(
            seen, other._error_log_density(axis, error) - own._error_log_density(axis, error), 0.0
        )
    _shift_speed(own, other, parts[..., 3], seen, change[..., 3], ratio[..., 3])
    return change.reshape(noise.shape), ratio.reshape(noise.shape)


def _shift_speed(
    own: ObservationLaw, other: ObservationLaw, z: Floats, seen: Bools, change: Floats, ratio: Floats
) -> None:
    if own.speed_sd > 0.0 and own.speed_sd != other.speed_sd:
        factor = own.speed_sd / other.speed_sd
        change[...] = np.where(seen, (factor - 1.0) * z, 0.0)
        ratio[...] = np.where(seen, np.log(factor) + 0.5 * z * z * (1.0 - factor * factor), 0.0)


def _tail(law: ObservationLaw, axis: int, error: Floats) -> Floats:
    # probability of an error beyond this one, on its side of the centre
    scale = law.scale[..., axis]
    power = 1.0 if law.power is None else law.power[..., axis]
    table, bound = student(law.dof[axis]), law.limit / scale
    size = np.minimum(np.abs(error - law.location[..., axis]) / scale, bound)
    beyond = table.upper_tail(bound, power)
    return (table.upper_tail(size, power) - beyond) / (1.0 - 2.0 * beyond)


def _divide(moved: Floats, density: Floats) -> Floats:
    return np.where(density > 0.0, moved / np.maximum(density, 1e-300), 0.0)
