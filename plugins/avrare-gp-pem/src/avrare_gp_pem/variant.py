"""From the features of a vehicle to the law of its observation: what all fitted models share at run time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem import normal
from avrare_gp_pem.features import Box, features
from avrare_gp_pem.law import ErrorLaw

Floats = NDArray[np.float64]
_STEEPEST = 700.0  # exp of this is still finite
_LOGISTIC = np.pi / 8  # the logistic function is near Phi(sqrt(pi / 8) x)


class Latents(Protocol):
    """Five functions of the inputs: detection, location of two errors, log scale of two errors."""

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """(n, 5) means and variances at normalised inputs (n, D); rows do not depend on one another."""
        ...


def _line() -> Floats:
    return np.array([1.0, 0.0])


@dataclass(frozen=True)
class Variant:
    """A fitted law of detections and errors.

    Attributes:
        latents: What was fitted.
        inputs: Names of the D columns it reads.
        input_mean: (D,) subtracted from the columns.
        input_sd: (D,) they are divided by.
        base_scale: (2, 2) rows are the two errors: what they are divided by is [0] + [1] x range [m].
        dof: (2,) degrees of freedom of the Student-t errors.
        limit: () errors end this far from their centre [m].
        link: "probit" or "logit": what turns the detection latent into a probability.
        frame: "vehicle": errors are along and across it; "ego": to the right of the ego and forward.
        bounds: (2, D) columns are cut to [0] and [1], what the fit has seen; it extrapolates nothing.
        line: (2,) calibration: [0] x latent + [1] is the argument of the link.
        stretch: (2,) calibration: factors on the scales of the errors.
    """

    latents: Latents
    inputs: tuple[str, ...]
    input_mean: Floats
    input_sd: Floats
    base_scale: Floats
    dof: Floats
    limit: Floats
    link: str
    frame: str
    bounds: Floats = field(default_factory=lambda: np.array([[-np.inf], [np.inf]]))
    line: Floats = field(default_factory=_line)
    stretch: Floats = field(default_factory=lambda: np.ones(2))

    def law(self, box: Box, speed_sd: float) -> ErrorLaw:
        """The law of observing ``box`` (fields (N, V))."""
        return self.law_of(features(box, self.inputs), box.range, speed_sd)

    def normalised(self, inputs: Floats) -> Floats:
        """(..., D) columns as ``latents`` read them."""
        if np.isfinite(self.bounds).any():
            inputs = np.clip(inputs, self.bounds[0], self.bounds[1])
        return (inputs - self.input_mean) / self.input_sd

    def law_of(self, inputs: Floats, distance: Floats, speed_sd: float) -> ErrorLaw:
        """The same from columns (..., D) and range (...)."""
        mean, variance = self.latents.predict(self.normalised(inputs).reshape(-1, inputs.shape[-1]))
        shape = (*inputs.shape[:-1], mean.shape[-1])
        return self.law_of_latents(mean.reshape(shape), variance.reshape(shape), distance, speed_sd)

    def law_of_latents(self, mean: Floats, variance: Floats, distance: Floats, speed_sd: float) -> ErrorLaw:
        """The same from the latents' moments (..., 5), with the uncertainty of the fit integrated out.

        Detection: if f ~ N(m, v) then E Phi(f) = Phi(m / sqrt(1 + v)), and nearly so for the logistic. A
        Student-t tail is proportional to scale^dof, whose mean over a log scale ~ N(m, v) is that of the
        scale exp(m + dof v / 2); the variance of the location is added to the square of the scale.
        """
        detect, miss = self._detection(mean[..., 0], variance[..., 0])
        means, variances = (part[..., 1:].reshape(*distance.shape, 2, 2) for part in (mean, variance))
        base = self.base_scale[:, 0] + self.base_scale[:, 1] * distance[..., None]
        widened = np.exp(2 * means[..., 1, :] + self.dof * variances[..., 1, :]) + variances[..., 0, :]
        return ErrorLaw(
            detect=detect,
            miss=miss,
            location=base * means[..., 0, :],
            scale=base * np.sqrt(widened) * self.stretch,
            dof=(float(self.dof[0]), float(self.dof[1])),
            limit=float(self.limit),
            speed_sd=speed_sd,
            in_ego_frame=self.frame == "ego",
        )

    def _detection(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Probability of a detection and of none."""
        slope, offset = self.line
        spread = slope * slope * variance
        if self.link == "probit":
            argument = (slope * mean + offset) / np.sqrt(1 + spread)
            return normal.cdf(argument), normal.cdf(-argument)
        argument = np.clip((slope * mean + offset) / np.sqrt(1 + _LOGISTIC * spread), -_STEEPEST, _STEEPEST)
        return 1 / (1 + np.exp(-argument)), 1 / (1 + np.exp(argument))
