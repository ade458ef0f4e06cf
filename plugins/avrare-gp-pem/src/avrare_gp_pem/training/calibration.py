"""Calibration on rows that were not used by the fit.

Six numbers per fit: slope and offset of the detection's argument, and for each error a factor on its scale
and its degrees of freedom. An overconfident model gets a slope below 1, a factor above 1 or a heavier tail.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import t as student_t

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.variant import Variant
from avrare_gp_pem.training.scores import error_fits

MIN_DOF, MAX_DOF = 1.05, 30.0  # range of the tables of ``student_t``
_PRIOR = 5.0  # weight of the prior that nothing needs to change [rows]
_TINY = 1e-12
_MAX_LOG_STRETCH = 5.0
_TOLERANCE = 2e-3  # loss of likelihood allowed for better tails [nats per error]
_CHANGES = np.linspace(-0.6, 0.6, 13)  # of the logarithm of dof - MIN_DOF
_LARGE = 4.0


@dataclass(frozen=True)
class UnseenRows:
    """Latents at rows that they were not fitted to, with the outcomes.

    Attributes:
        mean: (m, 5) means of the latents.
        variance: (m, 5) variances of the latents.
        distance: (m,) range [m].
        detected: (m,) outcomes.
        errors: (m, 2) in the variant's frame [m]; NaN where missed.
    """

    mean: Floats
    variance: Floats
    distance: Floats
    detected: Bools
    errors: Floats

    def take(self, index: Bools) -> UnseenRows:
        """Select rows."""
        return UnseenRows(**{one.name: getattr(self, one.name)[index] for one in fields(self)})


def calibrate(variant: Variant, unseen: UnseenRows) -> Variant:
    """Return the variant with its calibration fitted to ``unseen``, by likelihood and tails of errors."""
    count = len(unseen.detected)

    def detection_loss(parameters: Floats) -> float:
        log_slope, offset = parameters
        trial = replace(variant, line=np.array([np.exp(log_slope), offset]))
        law = trial.law_from_latents(unseen.mean, unseen.variance, unseen.distance, 0.0)
        outcome = np.where(unseen.detected, law.detect, law.miss)
        prior = _PRIOR * (log_slope**2 + offset**2) / count
        return float(-np.log(np.maximum(outcome, _TINY)).mean() + prior)

    log_slope, offset = _minimise(detection_loss, [0.0, 0.0])
    variant = replace(variant, line=np.array([np.exp(log_slope), offset]))
    seen = unseen.take(unseen.detected)
    stretch, dof = zip(*(_calibrate_error(variant, seen, axis) for axis in (0, 1)), strict=True)
    return replace(variant, stretch=np.array(stretch), dof=np.array(dof))


def _calibrate_error(variant: Variant, seen: UnseenRows, axis: int) -> tuple[float, float]:
    # The most likely degrees of freedom are dominated by the many small errors. Among all that predict nearly
    # as well, choose those whose shares of large errors are nearest to the observed ones: rare events depend
    # on them.
    likeliest = _minimise(lambda p: _error_loss(variant, seen, axis, p[0], p[1]), [0.0, np.log(2.0)])
    allowed = _error_loss(variant, seen, axis, *likeliest) + _TOLERANCE
    best, smallest_gap = likeliest, np.inf
    for freedom in likeliest[1] + _CHANGES:
        found = minimize_scalar(
            lambda p, freedom=freedom: _error_loss(variant, seen, axis, p, freedom),
            bounds=(likeliest[0] - 1.0, likeliest[0] + 1.0),
            options={"xatol": 1e-3},
        )
        gap = _tail_gap(variant, seen, axis, found.x, freedom) if found.fun <= allowed else np.inf
        if gap < smallest_gap:
            best, smallest_gap = np.array([found.x, freedom]), gap
    return _stretch(best[0]), _degrees(best[1])


def _error_loss(variant: Variant, seen: UnseenRows, axis: int, log_stretch: float, freedom: float) -> float:
    law = _law(variant, seen, log_stretch, freedom)
    scale = law.scale[:, axis]
    z = (seen.errors[:, axis] - law.location[:, axis]) / scale
    density = student_t.logpdf(z, _degrees(freedom)) - np.log(scale)
    prior = _PRIOR * (log_stretch**2 + (freedom - np.log(2.0)) ** 2) / len(scale)
    return float(-density.mean() + prior)


def _tail_gap(variant: Variant, seen: UnseenRows, axis: int, log_stretch: float, freedom: float) -> float:
    fit = error_fits(_law(variant, seen, log_stretch, freedom), seen.detected, seen.errors)[axis]
    few = _PRIOR / len(fit.z)
    pairs = (fit.beyond(_LARGE), fit.beyond_sd(_LARGE))
    return sum(float(np.log((share + few) / (own + few)) ** 2) for share, own in pairs)


def _law(variant: Variant, rows: UnseenRows, log_stretch: float, freedom: float) -> ObservationLaw:
    trial = replace(variant, stretch=np.full(2, _stretch(log_stretch)), dof=np.full(2, _degrees(freedom)))
    return trial.law_from_latents(rows.mean, rows.variance, rows.distance, 0.0)


def _stretch(log_stretch: float) -> float:
    # clipped, because errors that are all zero would shrink the scale to nothing
    return float(np.exp(np.clip(log_stretch, -_MAX_LOG_STRETCH, _MAX_LOG_STRETCH)))


def _degrees(freedom: float) -> float:
    return float(min(MIN_DOF + np.exp(freedom), MAX_DOF))


def _minimise(loss: Callable[[Floats], float], start: list[float]) -> Floats:
    found = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
    return np.asarray(found.x, np.float64)
