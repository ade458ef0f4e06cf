"""Calibration on rows that the fit has not seen. Needs the ``train`` extra.

Four numbers per fit: slope and offset of the detection's argument, and for each error a factor on its scale
and its degrees of freedom. A model that is surer of itself than its predictions deserve gets a slope below 1,
a factor above 1 or a heavier tail.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import t as student_t

from avrare_gp_pem.variant import Variant

Floats = NDArray[np.float64]
_LEAST_DOF, _MOST_DOF = 1.05, 30.0  # what the law's tables hold
_PRIOR = 5.0  # rows' worth of belief that nothing needs to change
_TINY = 1e-12


@dataclass(frozen=True)
class Unseen:
    """Latents at rows that they were not fitted to, and what happened there.

    Attributes:
        mean: (m, 5) of the latents.
        variance: (m, 5).
        distance: (m,) range [m].
        detected: (m,).
        errors: (m, 2) in the variant's frame [m]; NaN where missed.
    """

    mean: Floats
    variance: Floats
    distance: Floats
    detected: NDArray[np.bool_]
    errors: Floats


def calibrate(variant: Variant, unseen: Unseen) -> Variant:
    """The variant with its calibration fitted to ``unseen`` by maximum likelihood."""
    count = len(unseen.detected)

    def detection_loss(parameters: Floats) -> float:
        log_slope, offset = parameters
        trial = replace(variant, line=np.array([np.exp(log_slope), offset]))
        law = trial.law_of_latents(unseen.mean, unseen.variance, unseen.distance, 0.0)
        outcome = np.where(unseen.detected, law.detect, law.miss)
        prior = _PRIOR * (log_slope**2 + offset**2) / count
        return float(-np.log(np.maximum(outcome, _TINY)).mean() + prior)

    log_slope, offset = _best(detection_loss, [0.0, 0.0])
    variant = replace(variant, line=np.array([np.exp(log_slope), offset]))
    stretch, dof = zip(*(_error(variant, unseen, axis) for axis in (0, 1)), strict=True)
    return replace(variant, stretch=np.array(stretch), dof=np.array(dof))


def _error(variant: Variant, unseen: Unseen, axis: int) -> tuple[float, float]:
    """Stretch and degrees of freedom of one error."""
    seen = unseen.detected
    mean, variance, distance = unseen.mean[seen], unseen.variance[seen], unseen.distance[seen]
    error = unseen.errors[seen, axis]

    def degrees(parameter: float) -> float:
        return float(min(_LEAST_DOF + np.exp(parameter), _MOST_DOF))

    def loss(parameters: Floats) -> float:
        log_stretch, parameter = parameters
        dof = degrees(parameter)
        law = replace(variant, dof=np.full(2, dof)).law_of_latents(mean, variance, distance, 0.0)
        scale = law.scale[:, axis] * np.exp(log_stretch)
        density = student_t.logpdf((error - law.location[:, axis]) / scale, dof) - np.log(scale)
        prior = _PRIOR * (log_stretch**2 + (parameter - np.log(2.0)) ** 2) / len(error)
        return float(-density.mean() + prior)

    log_stretch, parameter = _best(loss, [0.0, np.log(2.0)])
    return float(np.exp(log_stretch)), degrees(parameter)


def _best(loss: Callable[[Floats], float], start: list[float]) -> Floats:
    found = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
    return np.asarray(found.x, np.float64)
