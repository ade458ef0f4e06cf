"""Better and worse detectors: a law of observations with scaled misses, errors and tails.

It also gives the move of the noise for another law to give the same observation, and the ratio of
their densities. A score function needs both, and so does the reweighing of rollouts for another detector.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.observation_model import NOISE_PER_VEHICLE, ObservationLaw
from avrare_gp_pem.runtime.student_t import student


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


def shift_noise(law: ObservationLaw, other: ObservationLaw, noise: Floats) -> tuple[Floats, Floats]:
    """Return how noise (N, 4 V) of ``law`` moves for another law to give the same observation.

    Returns:
        Changes (N, 4 V), and the logs of the ratio of the densities ``other`` / ``law`` of the errors that
        each number decides. Errors of a missed vehicle decide nothing. A ratio is NaN where ``other``
        observes an error that ``law`` cannot: weights of the observations of ``law`` would lose it.
    """
    parts = noise.reshape(*law.detect.shape, NOISE_PER_VEHICLE)
    change, ratio = np.zeros_like(parts), np.zeros_like(parts)
    seen = normal.cdf(parts[..., 0]) < law.detect
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio[..., 0] = np.where(seen, np.log(other.detect / law.detect), np.log(other.miss / law.miss))
        change[..., 0] = _shift_detection(parts[..., 0], seen, ratio[..., 0])
        for axis in (0, 1):
            error = law._error(axis, parts[..., 1 + axis])
            before, after = (_rank(each, axis, error) for each in (law, other))
            change[..., 1 + axis] = np.where(seen, after - before, 0.0)
            ratio[..., 1 + axis] = np.where(
                seen, other._error_log_density(axis, error) - law._error_log_density(axis, error), 0.0
            )
    _shift_speed(law, other, parts[..., 3], seen, change[..., 3], ratio[..., 3])
    ratio[..., 0] = np.where(_observes_more(law, other), np.nan, ratio[..., 0])
    return change.reshape(noise.shape), ratio.reshape(noise.shape)


def _observes_more(law: ObservationLaw, other: ObservationLaw) -> Bools:
    """Return (N, V) where ``other`` gives observations of probability 0 under ``law``."""
    rounding = 1e-12  # taken for probability 0
    misses = (law.miss == 0.0) & (other.miss > rounding)
    detects = (law.detect == 0.0) & (other.detect > rounding)
    further = other.limit > law.limit or (law.speed_sd == 0.0) != (other.speed_sd == 0.0)
    return np.asarray(misses | detects | further)


def _shift_detection(z: Floats, seen: Bools, log_ratio: Floats) -> Floats:
    # The rank of a detection, or that of a miss from above, is multiplied by the ratio.
    lower = np.where(seen, z, -z)
    moved = normal.quantile(np.log(normal.cdf(lower)) + log_ratio, lower) - lower
    return np.where(seen, moved, -moved)


def _shift_speed(
    law: ObservationLaw, other: ObservationLaw, z: Floats, seen: Bools, change: Floats, ratio: Floats
) -> None:
    if law.speed_sd != other.speed_sd and min(law.speed_sd, other.speed_sd) > 0.0:
        factor = law.speed_sd / other.speed_sd
        change[...] = np.where(seen, (factor - 1.0) * z, 0.0)
        ratio[...] = np.where(seen, np.log(factor) + 0.5 * z * z * (1.0 - factor * factor), 0.0)


def _rank(law: ObservationLaw, axis: int, error: Floats) -> Floats:
    # standard normal number of an error's rank: the probability beyond it, on its side of the centre
    scale = law.scale[..., axis]
    power = 1.0 if law.power is None else law.power[..., axis]
    table, bound = student(law.dof[axis]), law.limit / scale
    distance = error - law.location[..., axis]
    beyond = table.upper_tail(bound, power)
    tail = (table.upper_tail(np.minimum(np.abs(distance) / scale, bound), power) - beyond) / (
        1.0 - 2.0 * beyond
    )
    return np.copysign(normal.quantile(np.log(np.maximum(tail, 1e-300)), np.full_like(tail, -1.0)), distance)
