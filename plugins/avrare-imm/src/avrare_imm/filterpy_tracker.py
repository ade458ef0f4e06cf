"""Tracker that runs filterpy's ``IMMEstimator`` and ``KalmanFilter``, one track at a time.

It has the models, the options and the track life of ``imm``, and agrees with it where vehicles are detected;
it is there to test a stack that uses filterpy, and as a second opinion on ``imm``.

filterpy 2 calls a miss ``update(None)``. ``IMMEstimator`` then weighs the modes by a residual of zero with
the innovation covariance of the last detection, so that each miss favours the modes that had been most
certain. Here a missed detection leaves the mode probabilities as the transition matrix makes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Scene
from avrare.protocols import Bools, Floats
from avrare_imm.config import ImmConfig
from avrare_imm.imm import Mixture
from avrare_imm.models import ModelSet
from avrare_imm.tracker import ImmTracker, check_scene

if TYPE_CHECKING:
    from filterpy.kalman import IMMEstimator


class FilterpyTracker(ImmTracker):
    """``ImmTracker`` whose predictions and updates are filterpy's.

    Args:
        config: Options.
        scene: Provides the step and the lane centres.

    Raises:
        UsageError: A model set has a single model, which filterpy's estimator does not take; or detections
            have to be associated.
    """

    def __init__(self, config: ImmConfig, scene: Scene) -> None:
        super().__init__(config, scene)
        if config.association != "labelled":
            raise UsageError(
                "the tracker 'filterpy' needs to know which vehicle was detected", "use the tracker imm"
            )
        self._scene = scene
        for name, models in (("longitudinal", self.longitudinal), ("lateral", self.lateral)):
            if len(models.offset) < 2:
                raise UsageError(
                    f"the tracker 'filterpy' needs at least two {name} models",
                    "filterpy's IMMEstimator mixes several; use the tracker imm for a single one",
                )
        self._estimators = {id(models): _estimator(models) for models in (self.longitudinal, self.lateral)}

    def __reduce__(self) -> tuple[object, ...]:
        return FilterpyTracker, (self.config, self._scene)

    def _predict(self, models: ModelSet, mixture: Mixture) -> Mixture:
        imm, push = self._estimators[id(models)], np.ones((models.offset.shape[1], 1))
        writer = _Writer(mixture)
        for track in np.ndindex(mixture.probability.shape[:2]):
            _load(imm, mixture, track)
            imm.mu = mixture.probability[track]
            imm._compute_mixing_probabilities()
            imm.predict(push)
            writer.store(imm, track, imm.cbar)
        return writer.mixture()

    def _update(self, models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
        imm, writer = self._estimators[id(models)], _Writer(mixture)
        for track in np.argwhere(detected):
            at = tuple(track)
            _load(imm, mixture, at)
            imm.cbar = mixture.probability[at]
            imm.update(measurement[at][:, None])
            writer.store(imm, at, imm.mu)
        return writer.mixture()


def _estimator(models: ModelSet) -> IMMEstimator:
    from filterpy.kalman import IMMEstimator, KalmanFilter

    modes, n = models.offset.shape
    p = len(models.measurement_variance)
    filters = []
    for k in range(modes):
        filter_ = KalmanFilter(dim_x=n, dim_z=p)
        # The affine term E enters as the control input B u with u = 1.
        filter_.F, filter_.Q, filter_.B = models.dynamics[k], models.noise[k], np.diag(models.offset[k])
        filter_.H, filter_.R = np.eye(n)[:p], np.diag(models.measurement_variance)
        filters.append(filter_)
    return IMMEstimator(filters, np.full(modes, 1.0 / modes), models.transition)


def _load(imm: IMMEstimator, mixture: Mixture, track: tuple[int, ...]) -> None:
    for k, filter_ in enumerate(imm.filters):
        filter_.x, filter_.P = mixture.mean[track][k][:, None].copy(), mixture.covariance[track][k].copy()


class _Writer:
    """Copy of a mixture, into which the tracks of an estimator are written."""

    def __init__(self, mixture: Mixture) -> None:
        self.mean, self.covariance = mixture.mean.copy(), mixture.covariance.copy()
        self.probability = mixture.probability.copy()

    def store(self, imm: IMMEstimator, track: tuple[int, ...], probability: Floats) -> None:
        for k, filter_ in enumerate(imm.filters):
            self.mean[track][k], self.covariance[track][k] = filter_.x[:, 0], filter_.P
        self.probability[track] = probability

    def mixture(self) -> Mixture:
        return Mixture(self.mean, self.covariance, self.probability)


def build(config: ImmConfig, scene: Scene | None) -> FilterpyTracker:
    """Build the tracker for a driving scene.

    Raises:
        UsageError: The simulator has no scene, or a model set has a single model.
    """
    return FilterpyTracker(config, check_scene(scene, "filterpy"))
