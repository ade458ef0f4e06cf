"""Calibration on rows that the fit has not seen. Needs the ``train`` extra.

Four numbers per fit: slope and offset of the detection's argument, and for each error a factor on its scale
and its degrees of freedom. A model that is surer of itself than its predictions deserve gets a slope below 1,
a factor above 1 or a heavier tail.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import t as student_t

from avrare_gp_pem.law import ErrorLaw
from avrare_gp_pem.scores import error_fits
from avrare_gp_pem.variant import Variant

Floats = NDArray[np.float64]
_LEAST_DOF, _MOST_DOF = 1.05, 30.0  # what the law's tables hold
_PRIOR = 5.0  # rows' worth of belief that nothing needs to change
_TINY = 1e-12
_MOST_LOG_STRETCH = 5.0
_NEARLY = 2e-3  # so much worse may a law with better tails predict [nats per error]
_CHANGES = np.linspace(-0.6, 0.6, 13)  # of the logarithm of the degrees of freedom above the least
_LARGE = 4.0


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

    def take(self, index: NDArray[np.bool_]) -> Unseen:
        """A selection of the rows."""
        return Unseen(**{one.name: getattr(self, one.name)[index] for one in fields(self)})


def calibrate(variant: Variant, unseen: Unseen) -> Variant:
    """The variant with its calibration fitted to ``unseen``: by likelihood, errors by their tails too."""
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
    seen = unseen.take(unseen.detected)
    stretch, dof = zip(*(_error(variant, seen, axis) for axis in (0, 1)), strict=True)
    return replace(variant, stretch=np.array(stretch), dof=np.array(dof))


def _error(variant: Variant, seen: Unseen, axis: int) -> tuple[float, float]:
    """Stretch and degrees of freedom of one error, from detected rows.

    The most likely degrees of freedom follow the many small errors. So of all that predict nearly as well,
    those are taken whose shares of large errors are nearest to the shares seen: rare events hang on them.
    """
    likeliest = _best(lambda p: _error_loss(variant, seen, axis, p[0], p[1]), [0.0, np.log(2.0)])
    allowed = _error_loss(variant, seen, axis, *likeliest) + _NEARLY
    best, least = likeliest, np.inf
    for freedom in likeliest[1] + _CHANGES:
        around = (likeliest[0] - 1.0, likeliest[0] + 1.0)
        found = minimize_scalar(
            lambda p, freedom=freedom: _error_loss(variant, seen, axis, p, freedom),
            bounds=around,
            options={"xatol": 1e-3},
        )
        gap = _tail_gap(variant, seen, axis, found.x, freedom) if found.fun <= allowed else np.inf
        if gap < least:
            best, least = np.array([found.x, freedom]), gap
    return _stretch(best[0]), _degrees(best[1])


def _error_loss(variant: Variant, seen: Unseen, axis: int, log_stretch: float, freedom: float) -> float:
    """Negative log likelihood per error, with a belief that nothing needs to change."""
    law = _law(variant, seen, log_stretch, freedom)
    scale = law.scale[:, axis]
    z = (seen.errors[:, axis] - law.location[:, axis]) / scale
    density = student_t.logpdf(z, _degrees(freedom)) - np.log(scale)
    prior = _PRIOR * (log_stretch**2 + (freedom - np.log(2.0)) ** 2) / len(scale)
    return float(-density.mean() + prior)


def _tail_gap(variant: Variant, seen: Unseen, axis: int, log_stretch: float, freedom: float) -> float:
    """How far the shares beyond 4 scales, and beyond 4 standard deviations, are from the law's own."""
    fit = error_fits(_law(variant, seen, log_stretch, freedom), seen.detected, seen.errors)[axis]
    few = _PRIOR / len(fit.z)
    pairs = (fit.beyond(_LARGE), fit.beyond_sd(_LARGE))
    return sum(float(np.log((share + few) / (own + few)) ** 2) for share, own in pairs)


def _law(variant: Variant, rows: Unseen, log_stretch: float, freedom: float) -> ErrorLaw:
    trial = replace(variant, stretch=np.full(2, _stretch(log_stretch)), dof=np.full(2, _degrees(freedom)))
    return trial.law_of_latents(rows.mean, rows.variance, rows.distance, 0.0)


def _stretch(log_stretch: float) -> float:
    """Within bounds, because errors that are all zero ask for none at all."""
    return float(np.exp(np.clip(log_stretch, -_MOST_LOG_STRETCH, _MOST_LOG_STRETCH)))


def _degrees(freedom: float) -> float:
    """Degrees of freedom of the logarithm of those above the least."""
    return float(min(_LEAST_DOF + np.exp(freedom), _MOST_DOF))


def _best(loss: Callable[[Floats], float], start: list[float]) -> Floats:
    found = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
    return np.asarray(found.x, np.float64)
