"""Perception whose frames come at their own rate, late, or never; and a tracker with a period of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.driving import Observation, Prediction
from avrare.protocols import Bools, Floats, PerceptionErrorModel, Tracker
from avrare.scenario.timing import Timing
from avrare.stack.clock import Clock, move_samples, round_up, round_up_each
from avrare.stack.observation import observe
from avrare.stack.part_checks import find_noise_names, find_perfect_noise

_NEVER = 1 << 40
"""Steps until a frame that is lost or has been read."""


class ExactPerception(PerceptionErrorModel):
    """Perception that sees every vehicle as it is."""

    noise_size = 0

    def observe(self, world: object, noise: Floats) -> Observation:
        """Return the true states of the other vehicles."""
        return observe(None, world, noise, None)[0]


@dataclass(frozen=True)
class FrameQueue:
    """Frames that have not yet arrived.

    Attributes:
        step: (N,) steps since the start.
        frames: The newest frames, the newest first.
        waits: (N, K) steps until each of them arrives.
        model: Memory of a persistent model, or None.
    """

    step: NDArray[np.int64]
    frames: tuple[Observation, ...]
    waits: NDArray[np.int64]
    model: Any


class TimedPerception(PerceptionErrorModel):
    """Perception error model (persistent) with latency, jitter, losses and a frame rate.

    A step at which the tracker has no new frame to read gives an observation without detections.
    """

    def __init__(self, model: PerceptionErrorModel, timing: Timing, clock: Clock) -> None:
        self._model, self._timing, self._clock = model, timing, clock
        extra = {"lateness of frames": timing.perception_jitter, "loss of frames": timing.lost_frames}
        self._extra = [name for name, size in extra.items() if size]
        self.noise_names = (*find_noise_names(model, "perception noise"), *self._extra)
        self.perfect_noise = (*find_perfect_noise(model), *(0.0 for _ in self._extra))
        self.noise_size = len(self.noise_names)
        # no frame of a normal number is later than 8 standard deviations
        latest = round_up((timing.perception_latency + 8.0 * timing.perception_jitter) / clock.dt)
        self._capacity = latest // clock.sensor + clock.tracker // clock.sensor + 1
        self.warnings, self.ghost_slots = model.warnings, model.ghost_slots

    def start(self, noise: Floats) -> FrameQueue:
        """Return the memory at t = 0, where no frame is on its way."""
        inner = self._model.start(self._take_model_noise(noise))
        waits = np.full((len(noise), self._capacity), _NEVER)
        return FrameQueue(np.zeros(len(noise), dtype=np.int64), (), waits, inner)

    def observe(self, world: object, noise: Floats) -> Observation:
        """Return the first observation, without a delay."""
        return self._model.observe(world, self._take_model_noise(noise))

    def follow(self, world: object, noise: Floats, memory: FrameQueue) -> tuple[Observation, FrameQueue]:
        """Return the observation that the tracker reads at the next step, and the memory after it."""
        step, waits, inner = memory.step + 1, memory.waits - 1, memory.model
        frames = memory.frames or (_blank(self.observe(world, noise)),) * self._capacity
        now = int(step[0])  # that of all rows
        if now % self._clock.sensor == 0:
            frame, inner = self._model.follow(world, self._take_model_noise(noise), inner)
            frames = (frame, *frames[:-1])
            waits = np.concatenate([self._draw_waits(noise)[:, None], waits[:, :-1]], axis=1)
        if now % self._clock.tracker:
            return _blank(frames[0]), FrameQueue(step, frames, waits, inner)
        arrived = waits <= 0
        newest, fresh = arrived.argmax(axis=1), np.asarray(arrived.any(axis=1))
        rows = np.arange(len(step))
        read = batch.map_leaves(lambda *leaves: np.stack(leaves)[newest, rows], *frames)
        if self._timing.compensated and self._timing.perception_jitter:
            late = self._clock.dt * (newest * self._clock.sensor - self._clock.age)
            read = _advance(read, late[:, None])
        used = fresh[:, None] & (np.arange(self._capacity) >= newest[:, None])
        return _blank(read, ~fresh), FrameQueue(step, frames, np.where(used, _NEVER, waits), inner)

    def locate(self, ego: object, memory: FrameQueue) -> object:
        """Return the ego as the planner believes it, without delay."""
        return self._model.locate(ego, memory.model)

    def _take_model_noise(self, noise: Floats) -> Floats:
        return noise[:, : self.noise_size - len(self._extra)]

    def _draw_waits(self, noise: Floats) -> NDArray[np.int64]:
        timing = self._timing
        columns = iter(noise[:, self.noise_size - len(self._extra) : self.noise_size].T)
        waits = np.full(len(noise), self._clock.latency)
        if timing.perception_jitter:
            late = timing.perception_latency + timing.perception_jitter * np.maximum(next(columns), 0.0)
            waits = round_up_each(late / self._clock.dt)
        if timing.lost_frames:
            waits = np.where(next(columns) < NormalDist().inv_cdf(timing.lost_frames), _NEVER, waits)
        return waits


def _blank(seen: Observation, rows: Bools | None = None) -> Observation:
    """Return observations without detections at ``rows``, by default at all."""
    if rows is None:
        rows = np.ones(len(seen.detected), dtype=bool)
    elif not rows.any():
        return seen

    def without(leaf: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.where(rows[:, None], False if leaf.dtype == bool else np.nan, leaf)

    return batch.map_leaves(without, seen)


def _advance(seen: Observation, seconds: Floats) -> Observation:
    """Return detections where they will be, at the speeds that they have."""
    across = 0.0 if seen.speed_y is None else seen.speed_y
    return replace(seen, x=seen.x + seconds * seen.speed_x, y=seen.y + seconds * across)


@dataclass(frozen=True)
class PacedTrack:
    """Track of a tracker with a period, and its age (N,) in steps of the simulator."""

    track: Any
    age: NDArray[np.int64]


class PacedTracker(Tracker):
    """Tracker that is updated at its own period, and predicts in steps of the planner."""

    def __init__(self, tracker: Tracker, clock: Clock) -> None:
        self._tracker, self._clock = tracker, clock
        self.known_scene, self.burn_in = tracker.known_scene, tracker.burn_in * clock.tracker

    def start(self, world: object) -> PacedTrack:
        """Return the track at t = 0."""
        return PacedTrack(self._tracker.start(world), np.zeros(batch.size(world), dtype=np.int64))

    def update(self, track: PacedTrack, observation: Observation) -> PacedTrack:
        """Return the track one step of the simulator later."""
        age = track.age + 1
        if age[0] < self._clock.tracker:
            return PacedTrack(track.track, age)
        return PacedTrack(self._tracker.update(track.track, observation), np.zeros_like(age))

    def predict(self, track: PacedTrack, steps: int) -> Prediction:
        """Return positions now and over ``steps`` further steps of the planner."""
        clock = self._clock
        first, stride = float(track.age[0]) / clock.tracker, clock.planner / clock.tracker
        return move_samples(
            self._tracker.predict(track.track, round_up(first + stride * steps)), first, stride, steps
        )

    def features(self, track: PacedTrack) -> Floats | None:
        """Return the features (N, F) of the tracker itself."""
        return self._tracker.features(track.track)
