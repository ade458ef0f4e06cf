"""Fitted models at run time: from the features of a vehicle to the distribution of its observation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_gp_pem.config import MOST_GHOST_SLOTS
from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.features import Box, features
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student

MAX_EXPONENT = 700.0  # exp of this is still finite
NEAR = 20.0
"""Range below which the calibration may differ, by the share 1 - range / NEAR [m]."""


class Latents(Protocol):
    """Five functions of the inputs: detection, location of two errors, log scale of two errors."""

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return (n, 5) means and variances at normalised inputs (n, D); rows are independent."""
        ...


@dataclass(frozen=True)
class Variant:
    """Fitted distribution of detections and errors.

    Attributes:
        latents: The fitted functions.
        inputs: Names of the D columns that ``latents`` reads.
        input_mean: (D,) subtracted from the columns.
        input_sd: (D,) divides the columns.
        base_scale: (2, 2) row i: error i is divided by [0] + [1] x range [m].
        dof: (2,) degrees of freedom of the Student-t errors; inf: normal errors, without a limit.
        limit: Largest distance of an error from its centre [m].
        link: "probit" or "logit": turns the detection latent into a probability.
        frame: "vehicle": errors are along and across it; "ego": to the right of the ego and forward.
        bounds: (2, D) columns are clipped to [0] and [1], the range of the training rows: no extrapolation.
        line: (2,) calibration: [0] x latent + [1] is the argument of the link.
        stretch: (2,) calibration: factors on the scales of the errors.
        near: Calibration: added to the argument of the link, times nearness.
        tail: (2, 2) calibration, row i: log power of the tails of error i is [0] + [1] x nearness. Nearness
            falls from 1 at range 0 to 0 at ``NEAR``.
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
    line: Floats = field(default_factory=lambda: np.array([1.0, 0.0]))
    stretch: Floats = field(default_factory=lambda: np.ones(2))
    near: Floats = field(default_factory=lambda: np.zeros(()))
    tail: Floats = field(default_factory=lambda: np.zeros((2, 2)))

    def law(self, box: Box, speed_sd: float) -> ObservationLaw:
        """Return the distribution of the observation of ``box`` (fields (N, V))."""
        return self.law_from_columns(features(box, self.inputs), box.range, speed_sd)

    def law_from_columns(self, inputs: Floats, distance: Floats, speed_sd: float) -> ObservationLaw:
        """Return the law for columns (..., D) and range (...)."""
        mean, variance = self.latents.predict(self.normalise(inputs).reshape(-1, inputs.shape[-1]))
        shape = (*inputs.shape[:-1], mean.shape[-1])
        return self.law_from_latents(mean.reshape(shape), variance.reshape(shape), distance, speed_sd)

    def normalise(self, inputs: Floats) -> Floats:
        """Return columns (..., D) clipped and scaled as ``latents`` reads them."""
        if np.isfinite(self.bounds).any():
            inputs = np.clip(inputs, self.bounds[0], self.bounds[1])
        return (inputs - self.input_mean) / self.input_sd

    def law_from_latents(
        self, mean: Floats, variance: Floats, distance: Floats, speed_sd: float
    ) -> ObservationLaw:
        """Return the law for the moments of the latents (..., 5), with their uncertainty integrated out.

        Detection: if f ~ N(m, v) then E Phi(f) = Phi(m / sqrt(1 + v)), and nearly so for the logistic. A
        tail is proportional to scale^(dof / power), whose mean over a log scale ~ N(m, v) is that of the
        scale exp(m + dof / power v / 2); the variance of the location is added to the square of the scale.
        """
        nearness = _nearness(distance)
        detect, miss = self._detection(mean[..., 0], variance[..., 0], nearness)
        means, variances = (part[..., 1:].reshape(*distance.shape, 2, 2) for part in (mean, variance))
        base = self.base_scale[:, 0] + self.base_scale[:, 1] * distance[..., None]
        power = self.tail_power(distance) if self.tail.any() else None
        index = self.dof if power is None else self.dof / power
        index = np.where(np.isinf(index), 2.0, index)  # a normal law keeps its mean square
        widened = np.exp(2 * means[..., 1, :] + index * variances[..., 1, :]) + variances[..., 0, :]
        return ObservationLaw(
            detect=detect,
            miss=miss,
            location=base * means[..., 0, :],
            scale=base * np.sqrt(widened) * self.stretch,
            dof=(float(self.dof[0]), float(self.dof[1])),
            limit=float(self.limit),
            speed_sd=speed_sd,
            power=power,
            in_ego_frame=self.frame == "ego",
        )

    def tail_power(self, distance: Floats) -> Floats:
        """Return (..., 2) the powers of the errors' tails at ranges (...)."""
        return np.asarray(np.exp(self.tail[:, 0] + self.tail[:, 1] * _nearness(distance)[..., None]))

    def _detection(self, mean: Floats, variance: Floats, nearness: Floats) -> tuple[Floats, Floats]:
        slope, offset = self.line
        offset = offset + self.near * nearness
        spread = slope * slope * variance
        if self.link == "probit":
            argument = (slope * mean + offset) / np.sqrt(1 + spread)
            return normal.cdf(argument), normal.cdf(-argument)
        logistic = np.pi / 8  # the logistic function is close to Phi(sqrt(pi / 8) x)
        argument = (slope * mean + offset) / np.sqrt(1 + logistic * spread)
        argument = np.clip(argument, -MAX_EXPONENT, MAX_EXPONENT)
        return 1 / (1 + np.exp(-argument)), 1 / (1 + np.exp(argument))


def _nearness(distance: Floats) -> Floats:
    return np.asarray(np.maximum(0.0, 1.0 - distance / NEAR))


@dataclass(frozen=True)
class YawErrors:
    """Distribution of yaw errors: of the scores of ``avrare pem``, and of reported headings.

    A detector that sees a box guesses which end is the front: a tenth of all detections are half a turn off.
    So flips are a Bernoulli variable, logistic in range, and the error up to half a turn is Student-t with a
    scale linear in range.

    Attributes:
        flip: (2,) logit of a flip: at range 0, and per metre of range.
        scale: (2,) Student-t scale of the remaining error [rad]: at range 0, and per metre of range.
        dof: Degrees of freedom of the remaining error.
    """

    flip: Floats
    scale: Floats
    dof: Floats

    def flip_probability(self, distance: Floats) -> Floats:
        """Return the probability that a detection at this range [m] is half a turn off."""
        return np.asarray(1 / (1 + np.exp(-(self.flip[0] + self.flip[1] * distance))))

    def log_density(self, error: Floats, distance: Floats) -> Floats:
        """Return the log density of yaw errors [rad] in (-pi, pi]."""
        flipped, rest = separate_flips(error)
        flip = self.flip_probability(distance)
        scale = self.scale[0] + self.scale[1] * distance
        quarter = np.pi / 2 / scale
        density = student(float(self.dof)).truncated_log_density(rest / scale, quarter) - np.log(scale)
        return np.asarray(np.log(np.where(flipped, flip, 1 - flip)) + density)


def separate_flips(error: Floats) -> tuple[Bools, Floats]:
    """Return which yaw errors are nearer to half a turn than to none, and the rest in [-pi/2, pi/2]."""
    wrapped = (error + np.pi) % (2 * np.pi) - np.pi
    return np.abs(wrapped) > np.pi / 2, np.asarray((wrapped + np.pi / 2) % np.pi - np.pi / 2)


@dataclass(frozen=True)
class MeasuredPersistence:
    """Persistence of the errors in the data: correlation lasting + (1 - lasting) exp(-seconds / constant).

    Attributes:
        detection: (2,) time constant [s] and lasting share of detection.
        position: (2,) time constant [s] and lasting share of both position errors.
    """

    detection: Floats
    position: Floats


@dataclass(frozen=True)
class MeasuredGhosts:
    """False detections of the data.

    Attributes:
        rate: Mean number in a frame.
        persistence: Mean time that one lasts [s]; 0 where the data had no tracks of them.
        points: (P, 2) places ahead and to the left of the ego [m], equally likely.
        width: Standard deviation of the normal law around each of them [m].
    """

    rate: float
    persistence: float
    points: Floats
    width: float

    @property
    def slots(self) -> int:
        """Slots that hold nearly all ghosts of a frame, if their number is Poisson."""
        slots = max(3.0, 2.0 * self.rate, self.rate + 3.0 * math.sqrt(self.rate))
        return min(MOST_GHOST_SLOTS, math.ceil(slots))


@dataclass(frozen=True)
class FittedPem:
    """Fitted perception error model, as stored in a file.

    Attributes:
        clean: The detector without the artefact of label matching; the one to simulate with.
        delivered: The labels as they are, artefact included; None where the file has no such part.
        provenance: Origin and licence, by keyword.
        yaw: Yaw errors; None where the data had none.
        persistence: None where the data had no tracks.
        ghosts: None where the data had no false detections.
        ensemble: Refits to bootstrap samples of the data; empty where there are none.
    """

    clean: Variant
    delivered: Variant | None
    provenance: Mapping[str, str]
    yaw: YawErrors | None = None
    persistence: MeasuredPersistence | None = None
    ghosts: MeasuredGhosts | None = None
    ensemble: tuple[FittedPem, ...] = ()
