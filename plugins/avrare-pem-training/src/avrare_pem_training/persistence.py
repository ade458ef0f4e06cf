"""Persistence of errors, fitted to a log in which vehicles have tracks.

The detection of a vehicle and each of its errors are standard normal numbers in disguise (see ``draw``), and
between two frames of one track their correlation is taken to be c + (1 - c) exp(-seconds / tau). Both numbers
are the most likely ones for the pairs of frames: of detections and misses by the bivariate normal probability
of the pair, of errors by the density of their normal scores.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, ndtr, ndtri

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import MeasuredPersistence, Variant
from avrare_pem_training.table import DetectionTable, errors_in

LONGEST = 4.5
"""Greatest distance of two frames of a pair [s]."""
NEARBY = 40.0
"""Vehicles farther than this do not count [m]."""
_CERTAIN, _IMPOSSIBLE = 1e-9, 1e-12
_LOG_SECONDS, _LOGIT_LASTING = (-4.0, 4.0), (-6.0, 4.0)  # where the fit may go


@dataclass(frozen=True)
class Pairs:
    """Pairs of rows of one track.

    Attributes:
        first: (p,) rows.
        second: (p,) later rows of the same track.
        seconds: (p,) time between them [s].
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    seconds: Floats

    def take(self, index: NDArray[np.intp]) -> Pairs:
        """Select pairs."""
        return Pairs(self.first[index], self.second[index], self.seconds[index])


def track_pairs(rows: DetectionTable) -> Pairs:
    """Return all pairs of frames of a track, ``LONGEST`` seconds apart or less."""
    timed = np.flatnonzero(np.isfinite(rows.track) & np.isfinite(rows.time))
    order = timed[np.lexsort((rows.time[timed], rows.track[timed]))]
    pairs: list[NDArray[np.intp]] = []
    gap = 0
    while True:
        gap += 1
        first, second = order[:-gap], order[gap:]
        seconds = rows.time[second] - rows.time[first]
        near = (rows.track[second] == rows.track[first]) & (seconds <= LONGEST)
        if gap >= len(order) or not near.any():
            break
        pairs.append(np.stack([first, second])[:, near & (seconds > 0)])
    first, second = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), np.intp)
    return Pairs(first, second, rows.time[second] - rows.time[first])


def fit_persistence(variant: Variant, rows: DetectionTable) -> MeasuredPersistence | None:
    """Fit the persistence of detection and of position; None where there are too few pairs.

    The predictions are those of the model itself, though it was fitted to these rows: a network that has left
    them out is a worse model, and its misfit to a vehicle would count as lasting. For the same reason
    only vehicles within ``NEARBY`` count: the law is least certain at the edge of the detector's view.
    """
    rows = rows.take(rows.range < NEARBY)
    law, pairs = variant.law(rows, 0.0), track_pairs(rows)
    pairs = pairs.take(np.arange(0, len(pairs.first), 1 + len(pairs.first) // 40_000))
    both = pairs.take(np.flatnonzero(rows.detected[pairs.first] & rows.detected[pairs.second]))
    if len(both.first) < 200:
        return None
    bounds = detection_bounds(law)
    scores = normal_scores(law, errors_in(variant.frame, rows))

    def loss_of_detection(correlation: Floats) -> float:
        return -float(np.log(pair_probability(bounds, rows.detected, pairs, correlation)).mean())

    def loss_of_position(correlation: Floats) -> float:
        u, v = scores[both.first], scores[both.second]
        rest = (1 - correlation**2)[:, None]
        square = (u * u + v * v - 2 * correlation[:, None] * u * v) / rest
        return float((0.5 * (square + np.log(rest))).mean())

    return MeasuredPersistence(
        _fit_correlation(loss_of_detection, pairs.seconds), _fit_correlation(loss_of_position, both.seconds)
    )


def correlation_after(persistence: Floats, seconds: Floats) -> Floats:
    """Return the correlation of two latent numbers, from time constant and lasting share."""
    constant, lasting = persistence
    return np.asarray(lasting + (1 - lasting) * np.exp(-seconds / constant))


def detection_bounds(law: ObservationLaw) -> Floats:
    """Return the bounds below which a latent number means a detection."""
    return np.asarray(ndtri(np.clip(law.detect, _CERTAIN, 1 - _CERTAIN)))


def pair_probability(bounds: Floats, detected: Bools, pairs: Pairs, correlation: Floats) -> Floats:
    """Return (p,) the probability of the outcomes of both rows of each pair, detection or miss."""
    first, second = bounds[pairs.first], bounds[pairs.second]
    both = bivariate_normal(first, second, correlation)
    detect_first, detect_second = ndtr(first), ndtr(second)
    seen, again = detected[pairs.first], detected[pairs.second]
    after_detection = np.where(again, both, detect_first - both)
    after_miss = np.where(again, detect_second - both, 1 - detect_first - detect_second + both)
    return np.maximum(np.where(seen, after_detection, after_miss), _IMPOSSIBLE)


def bivariate_normal(h: Floats, k: Floats, correlation: Floats) -> Floats:
    """Return P(X < h, Y < k) of standard normal numbers (Drezner and Wesolowsky 1990), elementwise."""
    angle = np.arcsin(correlation)
    total = ndtr(h) * ndtr(k)
    for node, weight in zip(*np.polynomial.legendre.leggauss(16), strict=True):
        part = angle * (node + 1) / 2
        exponent = (h * h + k * k - 2 * h * k * np.sin(part)) / (2 * np.cos(part) ** 2)
        total = total + weight * angle / (4 * np.pi) * np.exp(-exponent)
    return np.asarray(total)


def normal_scores(law: ObservationLaw, errors: Floats) -> Floats:
    """Return the standard normal numbers (n, 2) that ``draw`` turns into these errors; NaN where missed."""
    scores = np.empty_like(errors)
    for axis, dof in enumerate(law.dof):
        z = (errors[:, axis] - law.location[:, axis]) / law.scale[:, axis]
        power = 1.0 if law.power is None else law.power[:, axis]
        # normal scores beyond 4 are cut off
        tail = np.maximum(student(dof).upper_tail(np.abs(np.nan_to_num(z)), power), ndtr(-4.0))
        scores[:, axis] = np.where(np.isnan(z), np.nan, np.sign(z) * -ndtri(tail))
    return scores


def describe_persistence(persistence: MeasuredPersistence | None) -> str:
    """Return a line for the terminal and the model card."""
    if persistence is None:
        return "persistence: not fitted, too few pairs of frames with `track` and `time`"
    words = [
        f"{name} {seconds:.2f} s and {share:.2f} for good"
        for name, (seconds, share) in (
            ("detection", persistence.detection),
            ("position", persistence.position),
        )
    ]
    return f"persistence: {', '.join(words)}"


def _fit_correlation(loss: Callable[[Floats], float], seconds: Floats) -> Floats:
    def unpack(parameters: Floats) -> Floats:
        return np.array([np.exp(parameters[0]), expit(parameters[1])])

    def loss_of(parameters: Floats) -> float:
        largest_correlation = 0.995
        return loss(np.minimum(correlation_after(unpack(parameters), seconds), largest_correlation))

    minimum = minimize(loss_of, [0.0, -1.5], method="L-BFGS-B", bounds=[_LOG_SECONDS, _LOGIT_LASTING])
    return unpack(minimum.x)
