"""Tracker that finds out itself which detection belongs to which track.

Global nearest neighbour (Bar-Shalom, Willett and Tian, *Tracking and Data Fusion*, 2011, section 6.4): the
most probable assignment of one list of detections to the tracks. A detection within the gate costs a track
d^2 + log |S|, the distance from its prediction and the spread of that; none costs as much as the gate would
let through at the widest prediction. Detections left over begin tracks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from avrare.driving import Observation, Scene, Vehicles
from avrare.protocols import Bools, Floats
from avrare_imm.assignment import Indices, assign
from avrare_imm.config import ImmConfig
from avrare_imm.imm import measurement_distance, predict_measurement
from avrare_imm.life import LifeRules
from avrare_imm.tracker import ImmTrack, ImmTracker

_LENGTH, _WIDTH = 4.5, 1.8  # of a track where the scene has no vehicle [m]


class AssociatingTracker(ImmTracker):
    """``ImmTracker`` of a list of detections in no order .

    It has a track for each vehicle of the scene, though not always of that vehicle, and spare ones.

    Args:
        config: Options, with a gate and a death.
        scene: Provides the step, the lane centres and the vehicles.
    """

    known_scene: Scene

    def __init__(self, config: ImmConfig, scene: Scene) -> None:
        super().__init__(config, scene)
        self.known_scene = _with_spare_tracks(scene, config.spare_tracks)
        self._life_rules = LifeRules(*config.birth, config.death)

    def start(self, world: Any) -> ImmTrack:
        """Return the tracks before any observation: at the vehicles or none, by option; no spare ones."""
        others, spare = world.others, self.config.spare_tracks
        state = ("x", "y", "heading", "speed", "acceleration")
        padded = {name: np.pad(getattr(others, name), ((0, 0), (0, spare))) for name in state}
        track = self._start_at(Vehicles(**padded))
        if track.life is None or self.config.start != "truth":
            return track
        real = np.arange(len(self.known_scene.names)) < others.x.shape[1]
        life = replace(
            track.life, exists=track.life.exists & real, detections=np.where(real, track.life.detections, 0)
        )
        return replace(track, life=life)

    def update(self, track: ImmTrack, observation: Observation) -> ImmTrack:
        """Return the tracks one step later, from a list of detections, fields (N, S)."""
        if not observation.x.shape[1]:
            observation = _with_a_slot(observation)
        predicted = self._predict_tracks(track)
        return self._update_tracks(predicted, _select(observation, self._associate(predicted, observation)))

    def features(self, track: ImmTrack) -> Floats:
        """Return (N, 5 T) which tracks exist, their places and steps; 0 where there is none."""
        predicted, exists = self.predict(track, 1), self._exists(track)
        with np.errstate(invalid="ignore"):
            parts = [
                predicted.x[..., 0],
                predicted.y[..., 0],
                *(part[..., 1] - part[..., 0] for part in vars(predicted).values()),
            ]
        return np.concatenate(
            [exists.astype(np.float64), *(np.where(exists, part, 0.0) for part in parts)], axis=1
        )

    @staticmethod
    def _exists(track: ImmTrack) -> Bools:
        assert track.life is not None  # a death is required
        return track.life.exists

    def _associate(self, predicted: ImmTrack, observation: Observation) -> Indices:
        """Return (N, T) the slot that each track gets, or begins with; -1 where it gets none."""
        assert predicted.life is not None
        assert self.config.gate is not None
        absent = self._life_rules.absent(predicted.life)
        distance, spread = self._distances(predicted, observation)  # (N, T, S), (N, T)
        widest = np.where(absent, -np.inf, spread).max(axis=1)
        within = (distance <= self.config.gate**2) & observation.detected[:, None] & ~absent[..., None]
        worth = self.config.gate**2 + widest[:, None, None] - distance - spread[..., None]
        # a detection at the very edge of the gate is worth as much as none, yet it counts
        chosen = assign(np.where(within, np.maximum(worth, 1e-12), -np.inf))
        return _begin_tracks(chosen, absent, observation)

    def _distances(self, predicted: ImmTrack, observation: Observation) -> tuple[Floats, Floats]:
        along = predict_measurement(self.longitudinal, predicted.longitudinal)
        across = predict_measurement(self.lateral, predicted.lateral)
        tracks, (count, slots) = along.log_determinant.shape[0], observation.x.shape
        distance = np.empty((count, tracks, slots))
        for slot in range(slots):
            detection = _select(observation, np.full((count, tracks), slot))
            measured = self._measurements(predicted, detection)
            distance[..., slot] = measurement_distance(along, measured[0])
            distance[..., slot] += measurement_distance(across, measured[1])
        return distance, (along.log_determinant + across.log_determinant).T


def _begin_tracks(chosen: Indices, absent: Bools, observation: Observation) -> Indices:
    """Give the detections that are left over to absent tracks, in the order of their x."""
    left = observation.detected.copy()
    rows, tracks = np.nonzero(chosen >= 0)
    left[rows, chosen[rows, tracks]] = False
    together = min(chosen.shape[1], left.shape[1])
    slots = np.lexsort((observation.x, ~left), axis=1)[:, :together]  # also where a place is NaN
    places = np.argsort(~absent, axis=1, kind="stable")[:, :together]
    begins = np.arange(together) < np.minimum(left.sum(axis=1), absent.sum(axis=1))[:, None]
    assigned = chosen.copy()
    given = np.where(begins, slots, np.take_along_axis(chosen, places, axis=1))
    np.put_along_axis(assigned, places, given, axis=1)
    return assigned


def _with_a_slot(observation: Observation) -> Observation:
    """Return an observation without slots as one with an empty slot."""
    padded: dict[str, Any] = {
        name: None if part is None else np.pad(part, ((0, 0), (0, 1)))
        for name, part in vars(observation).items()
    }
    return Observation(**padded)


def _select(observation: Observation, slots: Indices) -> Observation:
    """Return the detections of these slots (N, T); -1 is a miss."""
    taken = np.maximum(slots, 0)
    detected = np.take_along_axis(observation.detected, taken, axis=1) & (slots >= 0)

    def pick(part: Floats) -> Floats:
        return np.where(detected, np.take_along_axis(part, taken, axis=1), np.nan)

    speed_y, heading = observation.speed_y, observation.heading
    return Observation(
        detected=detected,
        x=pick(observation.x),
        y=pick(observation.y),
        speed_x=pick(observation.speed_x),
        speed_y=None if speed_y is None else pick(speed_y),
        heading=None if heading is None else pick(heading),
    )


def _with_spare_tracks(scene: Scene, spare: int) -> Scene:
    any_vehicle = len(scene.names) > 0
    length, width = (
        float(part.mean()) if any_vehicle else usual
        for part, usual in ((scene.lengths, _LENGTH), (scene.widths, _WIDTH))
    )
    return replace(
        scene,
        names=(*scene.names, *(f"track {k}" for k in range(1, spare + 1))),
        lengths=np.append(scene.lengths, np.full(spare, length)),
        widths=np.append(scene.widths, np.full(spare, width)),
        moving=np.append(scene.moving, np.ones(spare, bool)),
    )
