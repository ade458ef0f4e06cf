"""A perception error model learnt from a real detector: two sparse variational Gaussian processes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene, World
from avrare_gp_pem import normal
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.features import Box, box_of, features
from avrare_gp_pem.law import ErrorLaw, LawPem
from avrare_gp_pem.relative import relative
from avrare_gp_pem.store import FittedPem, load, locate
from avrare_gp_pem.visibility import category, visibility

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class GpPem(LawPem):
    """Detections and position errors as a Gaussian-process fit to a detector predicts them.

    Attributes:
        config: Options.
        scene: Sizes of the other vehicles.
        fitted: The fitted processes.
    """

    config: GpPemConfig
    scene: Scene
    fitted: FittedPem

    def law(self, world: World) -> ErrorLaw:
        """The distribution of the observation of ``world``."""
        levels = category(visibility(world, self.scene, self.config.rays))
        box = box_of(relative(world), self.scene.lengths, self.scene.widths, self.config.height, levels)
        return predict(self.fitted, box, self.config.speed_sd)


def predict(fitted: FittedPem, box: Box, speed_sd: float) -> ErrorLaw:
    """The law of observing ``box`` (fields (N, V)), with the uncertainty of the fit integrated out.

    Detection is exact: if f ~ N(m, v) then E Phi(f) = Phi(m / sqrt(1 + v)). A Student-t tail is proportional
    to scale^dof, whose mean over a log scale ~ N(m, v) is that of the scale exp(m + dof v / 2); the variance
    of the location is added to the square of the scale.
    """
    return predict_features(fitted, features(box), speed_sd)


def predict_features(fitted: FittedPem, inputs: Floats, speed_sd: float) -> ErrorLaw:
    """The same from features (..., 10)."""
    flat = (inputs.reshape(-1, inputs.shape[-1]) - fitted.input_mean) / fitted.input_sd
    shape = inputs.shape[:-1]
    mean, variance = (part.reshape(shape) for part in fitted.detection.predict(flat))
    argument = mean / np.sqrt(1 + variance)
    means, variances = (part.reshape(*shape, 2, 2) for part in fitted.error.predict(flat))
    base = fitted.base_scale[:, 0] + fitted.base_scale[:, 1] * inputs[..., :1]
    widened = np.exp(2 * means[..., 1, :] + fitted.dof * variances[..., 1, :]) + variances[..., 0, :]
    return ErrorLaw(
        detect=normal.cdf(argument),
        miss=normal.cdf(-argument),
        location=base * means[..., 0, :],
        scale=base * np.sqrt(widened),
        dof=(float(fitted.dof[0]), float(fitted.dof[1])),
        limit=fitted.limit,
        speed_sd=speed_sd,
    )


def build_gp(config: GpPemConfig, scene: Scene) -> GpPem:
    """The Gaussian-process model for a scene.

    Raises:
        UsageError: The model is unknown or its file cannot be read.
    """
    return GpPem(config, scene, load(locate(config.model)))
