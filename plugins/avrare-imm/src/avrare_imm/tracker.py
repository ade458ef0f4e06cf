"""Tracker: one filter along the road and one across it for each vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Prediction, Scene, Vehicles, World
from avrare.protocols import Bools, Floats, Tracker
from avrare_imm.config import ImmConfig
from avrare_imm.imm import (
    Mixture,
    agree,
    choose,
    forecast,
    fuse,
    innovation_distance,
    mix,
    predict,
    same_modes,
    set_probability,
    update,
)
from avrare_imm.life import Life, LifeRules
from avrare_imm.models import STOP, Horizon, ModelSet, lateral_models, longitudinal_models, look_ahead


@dataclass(frozen=True)
class ImmTrack:
    """Estimates of V other vehicles for N particles.

    Attributes:
        longitudinal: Modes over (x, vx, ax), in the order of ``ImmConfig.longitudinal_models``.
        lateral: Modes over (y, vy), gain by gain and in it lane by lane; then the one that stands, if any.
        life: Which vehicles have a track; None: all, from start to end.
    """

    longitudinal: Mixture
    lateral: Mixture
    life: Life | None = None


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
        lane_probabilities: (N, V, lanes) probability that it heads for each lane; the rest: it stands.
        exists: (N, V) whether there is a track; the other fields mean nothing where there is none.
    """

    x: Floats
    vx: Floats
    ax: Floats
    y: Floats
    vy: Floats
    longitudinal_covariance: Floats
    lateral_covariance: Floats
    lane_probabilities: Floats
    exists: Bools


class ImmTracker(Tracker):
    """Interacting-multiple-model tracker of all other vehicles (``avrare.protocols.Tracker``).

    Args:
        config: Options.
        scene: Provides the step and the lane centres; without lanes velocities across are constant, too.

    Attributes:
        burn_in: Observations before and at t = 0 (``avrare.stack.burn_in``).
    """

    def __init__(self, config: ImmConfig, scene: Scene) -> None:
        self.config = config
        self.burn_in = max(round(config.burn_in / scene.dt), 1) if config.start == "burn_in" else 0
        lanes = scene.road.lane_centres
        self._plane = not lanes
        self.lanes = np.array(lanes or (0.0,))
        self._gains = config.derivative_gains if lanes else (0.0,)
        self._measures_across = config.lateral_speed != "none"
        kinds = config.longitudinal_models
        self._standing = kinds.index("stand") if "stand" in kinds else None
        self.longitudinal = longitudinal_models(
            config.longitudinal_models,
            scene.dt,
            config.longitudinal_noise,
            (config.position_variance, *([config.speed_variance] if config.velocity == "noisy" else [])),
            config.stay_probability,
        )
        self.lateral = lateral_models(
            self._gains,
            config.proportional_gain if lanes else 0.0,
            tuple(self.lanes),
            scene.dt,
            config.lateral_noise,
            config.lateral_variance,
            config.stay_probability,
            config.lateral_speed_variance if self._measures_across else None,
            stands=self._standing is not None,
        )
        restart = None if config.gate is None else config.restart
        lasting = config.start == "truth" and config.death is None and restart is None
        self._rules = None if lasting else LifeRules(*config.birth, config.death, restart)
        self._horizons: dict[int, tuple[Horizon, Horizon]] = {}

    def start(self, world: World) -> ImmTrack:
        """Return the track before any observation: at the true world, or none, by option."""
        return self._start_at(world.others)

    def _start_at(self, others: Vehicles) -> ImmTrack:
        variance = self.config.initial_variance
        if self._rules is not None and self.config.start != "truth":
            return replace(self._begin(np.zeros((*others.x.shape, 3))), life=self._rules.none(others.x.shape))
        along = np.stack([others.x, others.speed * np.cos(others.heading), others.acceleration], axis=-1)
        across = np.stack([others.y, others.speed * np.sin(others.heading)], axis=-1)
        life = self._rules.all(others.x.shape) if self._rules is not None else None
        return self._at_state(along, across, (variance,) * 3, (variance,) * 2, life)

    def update(self, track: ImmTrack, observation: Observation) -> ImmTrack:
        """Return the track one step later, from fields (N, V).

        A vehicle that is missed, or detected beyond the gate, is only predicted. The options say when a
        vehicle without a track gets one, and when a track ends.
        """
        return self._update_tracks(self._predict_tracks(track), observation)

    def _predict_tracks(self, track: ImmTrack) -> ImmTrack:
        """Return tracks one step later, before its detections."""
        longitudinal = self._predict(self.longitudinal, track.longitudinal)
        lateral = self._predict(self.lateral, track.lateral)
        if self._standing is not None:
            lateral = set_probability(lateral, -1, longitudinal.probability[..., self._standing])
        return ImmTrack(longitudinal, lateral, track.life)

    def _update_tracks(self, predicted: ImmTrack, observation: Observation) -> ImmTrack:
        """Return predicted tracks after detections whose slots are those of the tracks."""
        longitudinal, lateral = predicted.longitudinal, predicted.lateral
        along, across = self._measurements(predicted, observation)
        accepted = observation.detected
        if self.config.gate is not None:
            distance = innovation_distance(self.longitudinal, longitudinal, along)
            distance = distance + innovation_distance(self.lateral, lateral, across)
            accepted = accepted & ~(distance > self.config.gate**2)  # a NaN is an error, and stays one
        longitudinal = self._update(self.longitudinal, longitudinal, along, accepted)
        lateral = self._update(self.lateral, lateral, across, accepted)
        if self._standing is not None:
            prior = predicted.longitudinal.probability[..., self._standing]
            stands = agree(longitudinal, self._standing, lateral, -1, prior)
            longitudinal = set_probability(longitudinal, self._standing, stands)
            lateral = set_probability(lateral, -1, stands)
        if self._rules is None or predicted.life is None:
            return ImmTrack(longitudinal, lateral)
        first = observation.detected & self._rules.absent(predicted.life)
        rejected = observation.detected & ~accepted & ~first
        restarts = self._rules.restarts(predicted.life, rejected)
        life = self._rules.update(predicted.life, accepted | first | restarts, rejected)
        begins = first | restarts
        if begins.any():
            speed = observation.speed_x
            if self.config.velocity == "none":
                speed = np.where(restarts, fuse(longitudinal)[0][..., 1], 0.0)
            seen = np.stack([observation.x, speed, observation.y], axis=-1)
            begun = self._begin(np.where(begins[..., None], seen, 0.0))
            longitudinal = choose(begins, begun.longitudinal, longitudinal)
            lateral = choose(begins, begun.lateral, lateral)
        return ImmTrack(longitudinal, lateral, life)

    def _measurements(self, predicted: ImmTrack, observation: Observation) -> tuple[Floats, Floats]:
        """Return the measurements of the filters along and across the road, (N, V, 1 or 2) each."""
        along = [observation.x, observation.speed_x][: len(self.longitudinal.measurement_variance)]
        across = [observation.y]
        if self._measures_across:
            across.append(self._speed_across(predicted, observation))
        return np.stack(along, axis=-1), np.stack(across, axis=-1)

    def _speed_across(self, predicted: ImmTrack, observation: Observation) -> Floats:
        kind = self.config.lateral_speed
        reported = observation.speed_y if kind == "velocity" else observation.heading
        if reported is None:
            option = "speed_y_sd" if kind == "velocity" else "heading"
            raise UsageError(
                f"tracker: lateral_speed: {kind} needs a perception that reports it",
                f"give the perception the option {option}, or remove lateral_speed",
            )
        if kind == "velocity":
            return reported
        speed = observation.speed_x
        if self.config.velocity == "none":
            speed = fuse(predicted.longitudinal)[0][..., 1]
        return np.asarray(speed * np.clip(np.tan(reported), -1.0, 1.0))  # a turned box has the same tangent

    def predict(self, track: ImmTrack, steps: int) -> Prediction:
        """Return expected positions now and over ``steps`` further steps, without observations.

        A vehicle without a track is infinitely far away.
        """
        if steps not in self._horizons:
            self._horizons[steps] = look_ahead(self.longitudinal, steps), look_ahead(self.lateral, steps)
        along, across = self._horizons[steps]
        x, y = forecast(along, track.longitudinal), forecast(across, track.lateral)
        if track.life is not None:
            exists = track.life.exists[..., None]
            x, y = np.where(exists, x, np.inf), np.where(exists, y, np.inf)
        return Prediction(x, y)

    def estimate(self, track: ImmTrack) -> FusedTrack:
        """Return fused states, covariances and lane probabilities."""
        along, longitudinal_covariance = fuse(track.longitudinal)
        across, lateral_covariance = fuse(track.lateral)
        chance = track.lateral.probability
        gains, lanes = len(self._gains), len(self.lanes)
        by_gain = chance[..., : gains * lanes].reshape(*chance.shape[:2], gains, lanes)
        return FusedTrack(
            x=along[..., 0],
            vx=along[..., 1],
            ax=along[..., 2],
            y=across[..., 0],
            vy=across[..., 1],
            longitudinal_covariance=longitudinal_covariance,
            lateral_covariance=lateral_covariance,
            lane_probabilities=reduce(add, np.moveaxis(by_gain, 2, 0)),
            exists=np.ones(along.shape[:2], bool) if track.life is None else track.life.exists,
        )

    def _predict(self, models: ModelSet, mixture: Mixture) -> Mixture:
        return predict(models, mix(models, mixture))

    def _update(self, models: ModelSet, mixture: Mixture, measurement: Floats, detected: Bools) -> Mixture:
        return update(models, mixture, measurement, detected)

    def _begin(self, measured: Floats) -> ImmTrack:
        """Return tracks from first detections: x, speed along the road and y, (N, V, 3)."""
        config = self.config
        x, speed, y = np.moveaxis(measured, -1, 0)
        measured_speed = config.velocity == "noisy"
        speed_variance = config.speed_variance if measured_speed else config.birth_speed_sd**2
        along = np.stack([x, speed, np.zeros_like(x)], axis=-1)
        across = np.stack([y, np.zeros_like(y)], axis=-1)
        variances = (config.position_variance, speed_variance, config.initial_variance)
        turn = config.birth_speed_sd**2 if self._plane else config.initial_variance
        return self._at_state(along, across, variances, (config.lateral_variance, turn))

    def _at_state(
        self,
        along: Floats,
        across: Floats,
        longitudinal_variances: Sequence[float],
        lateral_variances: Sequence[float],
        life: Life | None = None,
    ) -> ImmTrack:
        """Return tracks at (x, vx, ax) (N, V, 3) and (y, vy) (N, V, 2), in all modes with these variances."""
        modes = len(self.longitudinal.offset)
        even = np.full((*along.shape[:2], modes), 1.0 / modes)
        longitudinal = same_modes(along, longitudinal_variances, even)
        lateral = same_modes(across, lateral_variances, self._lane_prior(across[..., 0]))
        if self._standing is not None:
            deviations = 2.0  # standard deviations
            moves = along[..., 1] ** 2 > deviations**2 * longitudinal_variances[1]
            stands = np.where(moves, STOP, 1.0 / modes)
            longitudinal = set_probability(longitudinal, self._standing, stands)
            lateral = set_probability(lateral, -1, stands)
        return ImmTrack(longitudinal, lateral, life)

    def _lane_prior(self, y: Floats) -> Floats:
        config = self.config
        matches = np.abs(self.lanes - y[..., None]) < config.lane_tolerance
        weight = np.where(matches, config.lane_match_weight, config.lane_other_weight)
        gains = len(self._gains)
        total = gains * reduce(add, np.moveaxis(weight, -1, 0))
        prior = np.tile(weight / total[..., None], gains)
        if self._standing is None:
            return prior
        return np.concatenate([prior, np.zeros((*y.shape, 1))], axis=-1)


def build(config: ImmConfig, scene: Scene | None) -> ImmTracker:
    """Build the tracker for a driving scene.

    Raises:
        UsageError: The simulator has no scene.
    """
    scene = check_scene(scene, "imm")
    if config.association == "hungarian":
        from avrare_imm.association import AssociatingTracker  # it is made of this module's tracker

        return AssociatingTracker(config, scene)
    return ImmTracker(config, scene)


def check_scene(scene: Scene | None, tracker: str) -> Scene:
    """Return the scene; UsageError if the simulator has none."""
    if scene is None:
        raise UsageError(
            f"the tracker {tracker!r} needs a driving simulator: this one has no scene",
            "use a simulator with a road and other vehicles, or remove the tracker",
        )
    return scene
