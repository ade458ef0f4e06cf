"""Calibration on rows that were not used by the fit.

Of detection: slope and offset of its argument, and an offset for vehicles nearby. Of each error: a factor on
its scale, its degrees of freedom, and the power of its tails, the same at all ranges or another nearby. An
overconfident model gets a slope below 1, a factor above 1 or heavier tails.

The likelihood of an error depends mostly on the many small ones, and rare events on the few large ones. So
the form of the tails is chosen by prediction: each block of rows is left out in turn, and among the forms
that predict the errors left out nearly as well as the best one does, that one counts which predicts the large
ones best.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import t as student_t

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.variant import Variant

MIN_DOF, MAX_DOF = 1.05, 30.0  # range of the tables of ``student_t``
_PRIOR = 5.0  # weight of the prior that nothing needs to change [rows]
_TINY = 1e-12


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

    def take(self, index: Bools | NDArray[np.intp]) -> UnseenRows:
        """Select rows."""
        return UnseenRows(**{column.name: getattr(self, column.name)[index] for column in fields(self)})

    def law(self, variant: Variant) -> ObservationLaw:
        """Return the variant's predictions for these rows."""
        return variant.law_from_latents(self.mean, self.variance, self.distance, 0.0)


def calibrate(variant: Variant, unseen: UnseenRows) -> Variant:
    """Return the variant with its calibration fitted to ``unseen``, rows in the order of recording."""
    count = len(unseen.detected)

    def detection_loss(parameters: Floats) -> float:
        log_slope, offset, near = parameters
        trial = replace(variant, line=np.array([np.exp(log_slope), offset]), near=np.array(near))
        law = unseen.law(trial)
        outcome = np.where(unseen.detected, law.detect, law.miss)
        # a prior standard deviation of 2 for the offset nearby
        prior = _PRIOR * (log_slope**2 + offset**2) + 0.5 * (near / 2.0) ** 2
        return float(-np.log(np.maximum(outcome, _TINY)).mean() + prior / count)

    log_slope, offset, near = _minimise(detection_loss, [0.0, 0.0, 0.0])
    variant = replace(variant, line=np.array([np.exp(log_slope), offset]), near=np.array(near))
    seen = unseen.take(unseen.detected)
    for axis in (0, 1):
        variant = _with_error(variant, axis, _calibrate_error(variant, seen, axis))
    return variant


def _calibrate_error(variant: Variant, seen: UnseenRows, axis: int) -> Floats:
    every_row = np.arange(len(seen.detected))
    forms = (0, 1, 2)  # free numbers of the tails' power: none (Student-t), one, one more for nearby vehicles
    losses = np.zeros((len(forms), 2))  # all errors, large errors
    for block in np.array_split(every_row, 5):
        rest = _ErrorsUnderLaws(variant, seen.take(np.setdiff1d(every_row, block)), axis)
        left_out = _ErrorsUnderLaws(variant, seen.take(block), axis)
        for form in forms:
            losses[form] += left_out.losses(_fit_error(rest, form))
    likely, large = losses.T / len(every_row)
    allowed = likely <= likely.min() + 2e-3  # nats per error that better tails may cost
    return _fit_error(_ErrorsUnderLaws(variant, seen, axis), int(np.argmin(np.where(allowed, large, np.inf))))


def _fit_error(errors: _ErrorsUnderLaws, form: int) -> Floats:
    """Return log stretch, log (dof - MIN_DOF) and two log powers of the tails, free as the form says."""
    centre = np.array([0.0, np.log(2.0), 0.0, 0.0])
    free = 2 + form

    def loss(parameters: Floats) -> float:
        complete = np.append(parameters, centre[free:])
        shift = complete - centre
        return float(errors.loss(complete).mean() + _PRIOR * (shift @ shift) / len(errors.seen.detected))

    minimum = minimize(loss, centre[:free], method="L-BFGS-B", options={"ftol": 1e-7})
    return np.append(minimum.x, centre[free:])


class _ErrorsUnderLaws:
    """One error of m detections, under laws of any parameters; their truncation, far out, is left aside."""

    def __init__(self, variant: Variant, rows: UnseenRows, axis: int) -> None:
        self.variant, self.seen, self.axis = variant, rows, axis
        self.given = rows.law(variant)
        self._scale_depends_on_tails = bool(rows.variance.any())

    def loss(self, parameters: Floats) -> Floats:
        """Return (m,) negative log densities of the errors."""
        return self._loss(*self._standard(parameters))

    def losses(self, parameters: Floats) -> Floats:
        """Return two sums of the same: exact, and with errors below ``_LARGE`` given scales only as small."""
        z, scale, power, dof = self._standard(parameters)
        exact = self._loss(z, scale, power, dof)
        size = 4.0 * self.given.scale[:, self.axis] / scale  # an error beyond four of the fitted scales
        beyond = 2 * student_t.sf(np.sinh(np.arcsinh(power * size) / power), dof)
        large = np.where(np.abs(z) > size, exact, -np.log1p(-np.minimum(beyond, 1 - _TINY)))
        return np.array([exact.sum(), large.sum()])

    def _standard(self, parameters: Floats) -> tuple[Floats, Floats, Floats, float]:
        """Return standardised errors, scales [m], powers of the tails and degrees of freedom."""
        trial, axis = _with_error(self.variant, self.axis, parameters), self.axis
        power = np.ones(len(self.seen.distance))
        if trial.tail[axis].any():
            power = trial.tail_power(self.seen.distance)[:, axis]
        if self._scale_depends_on_tails:
            scale = self.seen.law(trial).scale[:, axis]
        else:
            scale = self.given.scale[:, axis] * (trial.stretch[axis] / self.variant.stretch[axis])
        z = (self.seen.errors[:, axis] - self.given.location[:, axis]) / scale
        return z, scale, power, float(trial.dof[axis])

    @staticmethod
    def _loss(z: Floats, scale: Floats, power: Floats, dof: float) -> Floats:
        root = np.arcsinh(power * z) / power
        constant = math.lgamma(dof / 2) - math.lgamma((dof + 1) / 2) + 0.5 * math.log(dof * math.pi)
        student = constant + (dof + 1) / 2 * np.log1p(np.sinh(root) ** 2 / dof)
        jacobian = np.log(np.cosh(root)) - 0.5 * np.log1p((power * z) ** 2)
        return np.asarray(student - jacobian + np.log(scale))


def _with_error(variant: Variant, axis: int, parameters: Floats) -> Variant:
    log_stretch, freedom, *log_powers = parameters
    stretch, dof, tail = variant.stretch.copy(), variant.dof.copy(), variant.tail.copy()
    most_log = 5.0
    # clipped, because errors that are all zero would shrink the scale to nothing
    stretch[axis] = np.exp(np.clip(log_stretch, -most_log, most_log))
    dof[axis] = min(MIN_DOF + np.exp(freedom), MAX_DOF)
    most_log_power = 1.0
    tail[axis] = np.clip(log_powers, -most_log_power, most_log_power)
    return replace(variant, stretch=stretch, dof=dof, tail=tail)


def _minimise(loss: Callable[[Floats], float], start: list[float]) -> Floats:
    minimum = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-7})
    return np.asarray(minimum.x, np.float64)
