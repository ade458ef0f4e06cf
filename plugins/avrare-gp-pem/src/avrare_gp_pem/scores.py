"""How well a fitted law predicts rows that it has not seen: detection, errors, and the tails of errors.

A standardised error is z = (error - location) / scale, both of the law. For a Student-t law P(|z| > 4) is a
few per cent: the question is whether it is the law's own. The normal score is the standard normal number that
would have drawn the error; it is what an importance sampler or a search shifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.law import ErrorLaw
from avrare_gp_pem.metrics import detection_metrics
from avrare_gp_pem.student import student

Floats = NDArray[np.float64]
NAMES = {"vehicle": ("along", "across"), "ego": ("right", "forward")}
"""What the two errors of a frame are called."""
TAILS = (2.0, 4.0, 8.0)
"""Sizes of z whose share is compared."""
_GRID = 4001


@dataclass(frozen=True)
class ErrorFit:
    """One error of all detections, against its law.

    Attributes:
        z: (m,) standardised errors.
        log_density: (m,) of the errors [log 1/m].
        bound: (m,) where the law ends, in units of its scale.
        scale: (m,) the law's [m].
        dof: The law's degrees of freedom.
    """

    z: Floats
    log_density: Floats
    bound: Floats
    scale: Floats
    dof: float

    def beyond(self, size: float) -> tuple[float, float]:
        """Share of |z| > ``size``: observed, and the law's own."""
        tail, end = (student(self.dof).upper_tail(x) for x in (np.minimum(self.bound, size), self.bound))
        own = np.where(self.bound > size, 2 * (tail - end) / (1 - 2 * end), 0.0)
        return float((np.abs(self.z) > size).mean()), float(own.mean())

    def beyond_sd(self, count: float) -> tuple[float, float]:
        """The same beyond ``count`` of the law's own standard deviations."""
        sd = _truncated_sd(self.dof, self.bound)
        tail, end = (
            student(self.dof).upper_tail(x) for x in (np.minimum(self.bound, count * sd), self.bound)
        )
        return float((np.abs(self.z) > count * sd).mean()), float((2 * (tail - end) / (1 - 2 * end)).mean())

    def normal_tail(self) -> Floats:
        """(m,) two-sided probability of an error at least as large; uniform if the law is right."""
        tail, end = (
            student(self.dof).upper_tail(x) for x in (np.minimum(np.abs(self.z), self.bound), self.bound)
        )
        return (tail - end) / (0.5 - end)


def error_fits(law: ErrorLaw, detected: NDArray[np.bool_], errors: Floats) -> tuple[ErrorFit, ErrorFit]:
    """Both errors (n, 2) of the detected rows against their law (fields (n,))."""
    first, second = (_fit(law, detected, errors, axis) for axis in (0, 1))
    return first, second


def score(
    law: ErrorLaw, detected: NDArray[np.bool_], errors: Floats, base_rate: float, frame: str
) -> dict[str, float]:
    """All scores of a law (fields (n,)) on rows.

    Args:
        law: Predictions.
        detected: (n,) what happened.
        errors: (n, 2) in the law's frame [m]; NaN where missed.
        base_rate: Detection rate of the training rows, the baseline.
        frame: "vehicle" or "ego": names the errors.

    Returns:
        ``detection_*`` (nats per row; ``calibration_error`` is the expected calibration error over ten bins
        of equal count), and per error: ``nll`` [nats, errors in metres], ``sd`` the mean scale, ``z4`` and
        the like the observed share beyond 4 scales, ``z4_own`` the law's, ``4sd`` the same beyond 4 standard
        deviations.
    """
    scores = detection_metrics(law.detect, detected, base_rate)
    scores["error_rows"] = float(detected.sum())
    for name, fit in zip(NAMES[frame], error_fits(law, detected, errors), strict=True):
        scores[f"{name}_nll"] = -float(fit.log_density.mean())
        scores[f"{name}_dof"] = fit.dof
        for size in TAILS:
            scores[f"{name}_z{size:g}"], scores[f"{name}_z{size:g}_own"] = fit.beyond(size)
        scores[f"{name}_4sd"], scores[f"{name}_4sd_own"] = fit.beyond_sd(4.0)
    return scores


def _fit(law: ErrorLaw, detected: NDArray[np.bool_], errors: Floats, axis: int) -> ErrorFit:
    scale = law.scale[detected, axis]
    z = (errors[detected, axis] - law.location[detected, axis]) / scale
    bound = law.limit / scale
    density = student(law.dof[axis]).truncated_log_density(z, bound) - np.log(scale)
    return ErrorFit(z, density, bound, scale, law.dof[axis])


def _truncated_sd(dof: float, bound: Floats) -> Floats:
    """Standard deviation of a Student-t variable given |T| <= bound, from a table over the bound."""
    x = np.linspace(0.0, np.arcsinh(float(bound.max())), _GRID)
    t = np.sinh(x)
    density = np.exp(student(dof).log_density(t)) * np.cosh(x)
    steps = np.diff(x) / 2
    mass, second = (np.append(0.0, np.cumsum((f[1:] + f[:-1]) * steps)) for f in (density, density * t * t))
    at = np.arcsinh(bound)
    return np.asarray(np.sqrt(np.interp(at, x, second) / np.interp(at, x, mass)))
