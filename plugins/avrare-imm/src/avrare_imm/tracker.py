"""Tracker: one filter along the road and one across it for each vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Prediction, Scene
from avrare.protocols import Floats
from avrare_imm.config import ImmConfig
from avrare_imm.imm import Mixture, forecast, fuse, step
from avrare_imm.models import Horizon, ModelSet, lateral_models, longitudinal_models, look_ahead


@dataclass(frozen=True)
class ImmTrack:
    """Estimates of V other vehicles for N particles.

    Attributes:
        longitudinal: Modes over (x, vx, ax), in the order of ``ImmConfig.longitudinal_models``.
        lateral: Modes over (y, vy), gain by gain and within it lane by lane.
    """

    longitudinal: Mixture
    lateral: Mixture


@dataclass(frozen=True)
class FusedTrack:
    """Fused track, for pictures and diagnostics.

    Attributes:
        x: (N, V) position along the road [m].
        vx: (N, V) speed along the road [m/s].
        ax: (N, V) acceleration along the road [m/s^2].
        y: (N, V) position across the road [m].
        vy: (N, V) speed across the road [m/s].
        longitudinal_covariance: (N, V, 3, 3) of (x, vx, ax).
        lateral_covariance: (N, V, 2, 2) of (y, vy).
        lane_probabilities: (N, V, lanes) probability that the vehicle heads for each lane.
    """

    x: Floats
    vx: Floats
    ax: Floats
    y: Floats
    vy: Floats
    longitudinal_covariance: Floats
    lateral_covariance: Floats
    lane_probabilities: Floats


class ImmTracker:
    """Interacting-multiple-model tracker of all other vehicles (``avrare.protocols.Tracker``).

    Args:
        config: Options.
        scene: Provides the step and the lane centres.
    """

    def __init__(self, config: ImmConfig, scene: Scene) -> None:
        self.config = config
        self.lanes = np.array(scene.road.lane_centres)
        self.longitudinal = longitudinal_models(
            config.longitudinal_models,
            scene.dt,
            config.longitudinal_noise,
            (config.position_variance, config.speed_variance),
            config.stay_probability,
        )
        self.lateral = lateral_models(
            config.derivative_gains,
            config.proportional_gain,
            scene.road.lane_centres,
            scene.dt,
            config.lateral_noise,
            config.lateral_variance,
            config.stay_probability,
        )
        self._horizons: dict[int, tuple[Horizon, Horizon]] = {}

    def start(self, world: Any) -> ImmTrack:
        """Return the track at t = 0: every mode at the true state of ``world.others``, fields (N, V)."""
        others = world.others
        along = np.stack([others.x, others.speed * np.cos(others.heading), others.acceleration], axis=-1)
        across = np.stack([others.y, others.speed * np.sin(others.heading)], axis=-1)
        even = np.full((*others.x.shape, len(self.longitudinal.offset)), 1.0 / len(self.longitudinal.offset))
        return ImmTrack(
            self._at_state(self.longitudinal, along, even),
            self._at_state(self.lateral, across, self._lane_prior(others.y)),
        )

    def update(self, track: ImmTrack, observation: Observation) -> ImmTrack:
        """Return the track one step later, from fields (N, V); a missed vehicle is only predicted."""
        along = np.stack([observation.x, observation.speed_x], axis=-1)
        seen = observation.detected
        return ImmTrack(
            step(self.longitudinal, track.longitudinal, along, seen),
            step(self.lateral, track.lateral, observation.y[..., None], seen),
        )

    def predict(self, track: ImmTrack, steps: int) -> Prediction:
        """Return expected positions now and over ``steps`` further steps, without observations."""
        if steps not in self._horizons:
            self._horizons[steps] = look_ahead(self.longitudinal, steps), look_ahead(self.lateral, steps)
        along, across = self._horizons[steps]
        return Prediction(forecast(along, track.longitudinal), forecast(across, track.lateral))

    def estimate(self, track: ImmTrack) -> FusedTrack:
        """Return fused states, covariances and lane probabilities."""
        along, longitudinal_covariance = fuse(track.longitudinal)
        across, lateral_covariance = fuse(track.lateral)
        chance = track.lateral.probability
        by_gain = chance.reshape(*chance.shape[:2], len(self.config.derivative_gains), len(self.lanes))
        return FusedTrack(
            x=along[..., 0],
            vx=along[..., 1],
            ax=along[..., 2],
            y=across[..., 0],
            vy=across[..., 1],
            longitudinal_covariance=longitudinal_covariance,
            lateral_covariance=lateral_covariance,
            lane_probabilities=reduce(add, np.moveaxis(by_gain, 2, 0)),
        )

    def _at_state(self, models: ModelSet, state: Floats, probability: Floats) -> Mixture:
        m, n = models.offset.shape
        covariance = self.config.initial_variance * np.eye(n)
        return Mixture(
            np.repeat(state[:, :, None], m, axis=2),
            np.tile(covariance, (*state.shape[:2], m, 1, 1)),
            probability,
        )

    def _lane_prior(self, y: Floats) -> Floats:
        config = self.config
        matches = np.abs(self.lanes - y[..., None]) < config.lane_tolerance
        weight = np.where(matches, config.lane_match_weight, config.lane_other_weight)
        gains = len(config.derivative_gains)
        total = gains * reduce(add, np.moveaxis(weight, -1, 0))
        return np.tile(weight / total[..., None], gains)


def build(config: ImmConfig, scene: Scene | None) -> ImmTracker:
    """Build the tracker for a driving scene.

    Raises:
        UsageError: The simulator has no scene.
    """
    if scene is None:
        raise UsageError(
            "the tracker 'imm' needs a driving simulator: this one has no scene",
            "use a simulator with a road and other vehicles, or remove the tracker",
        )
    return ImmTracker(config, scene)
