"""Small driving and flying problems in NumPy; brute force gives their probabilities (``truths.json``)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.problems.perching import Perching
from benchmarks.calibration.problems.problem import Always, Floats, Problem, stepwise

TRUTHS = Path(__file__).with_name("truths.json")
_DT = 0.2
"""Seconds of a step."""


class Following(Always):
    """A car follows one that brakes and speeds up at random, by a noisy radar.

    State: gap, speed of the leader, own speed, acceleration of the leader, filtered gap.
    """

    noise_size, steps, start = 2, 50, (30.0, 25.0, 25.0, 0.0, 30.0)

    def __init__(self, least: float, braking: float) -> None:
        self.least, self.braking = least, braking

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Measure, act, move."""
        gap, leader, own, brake, seen = state.T
        seen = 0.6 * seen + 0.4 * (gap + 1.5 * noise[:, 0])
        action = np.clip(0.3 * (seen - 5.0 - own) + 0.9 * (leader - own), -6.0, 2.0)
        brake = 0.9 * brake + self.braking * noise[:, 1]
        moved_leader = np.maximum(leader + _DT * np.clip(brake, -8.0, 3.0), 0.0)
        moved_own = np.maximum(own + _DT * action, 0.0)
        gap = gap + _DT * (leader - own)
        return np.stack([gap, moved_leader, moved_own, brake, seen], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the gap (N,) beyond the least allowed."""
        return state[:, 0] - self.least


class LaneChange(Always):
    """A car from the next lane cuts in; it is seen in a step with a probability, and late.

    State: gap, its speed, own speed, its offset from our lane, whether it was seen.
    """

    noise_size, steps, start = 3, 40, (14.0, 22.0, 27.0, 3.5, 0.0)

    def __init__(self, least: float, missed: float) -> None:
        self.least, self.missed = least, missed

    def step(self, state: Floats, noise: Floats) -> Floats:
        """See or not, brake, move."""
        gap, other, own, offset, seen = state.T
        seen = np.where(noise[:, 0] > self.missed, 1.0, 0.7 * seen)
        measured = gap + 1.0 * noise[:, 1]
        wanted = 0.4 * (measured - 10.0) + 1.2 * (other - own)
        action = np.where((seen > 0.5) & (offset < 2.8), np.clip(wanted, -7.0, 1.0), 0.0)
        offset = np.maximum(offset - _DT * (1.0 + 0.3 * noise[:, 2]), 0.0)
        gap = gap + _DT * (other - own)
        other = other + _DT * 0.8 * noise[:, 2]
        return np.stack([gap, other, np.maximum(own + _DT * action, 0.0), offset, seen], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the gap (N,) beyond the least, or the distance between the lanes where that is larger."""
        return np.maximum(state[:, 0] - self.least, 2.0 * (state[:, 3] - 1.8))


class LaneKeeping(Always):
    """A double integrator is kept in its lane by noisy feedback; it may leave on either side.

    State: offset, lateral speed.
    """

    noise_size, steps, start = 2, 60, (0.0, 0.0)

    def __init__(self, width: float) -> None:
        self.width = width

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Measure, steer, drift."""
        x, v = state.T
        action = -0.9 * (x + 0.25 * noise[:, 0]) - 1.3 * v
        return np.stack([x + _DT * v, v + _DT * action + 0.12 * noise[:, 1]], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the distance (N,) to the nearer edge."""
        return self.width - np.abs(state[:, 0])


class Pedestrian(Always):
    """A pedestrian walks towards the road; the car brakes when two detections follow each other.

    State: distance of the car, its speed, lateral distance of the pedestrian, detections in a row, braking.
    """

    noise_size, steps, start = 2, 30, (45.0, 13.0, 5.0, 0.0, 0.0)

    def __init__(self, missed: float) -> None:
        self.missed = missed

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Detect, brake, move."""
        far, speed, aside, row, braking = state.T
        seen = noise[:, 0] > self.missed + 0.01 * far
        row = np.where(seen, row + 1.0, 0.0)
        braking = np.maximum(braking, row >= 2.0)
        far = far - _DT * speed
        speed = np.maximum(speed - _DT * 6.0 * braking, 0.0)
        aside = np.maximum(aside - _DT * (1.2 + 0.5 * noise[:, 1]), 0.0)
        return np.stack([far, speed, aside, row, braking], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the distance (N,) to the pedestrian beyond a metre, along the road or aside."""
        return np.maximum(np.abs(state[:, 0]) - 1.0, 3.0 * (state[:, 2] - 1.0))


class Glider(Always):
    """A glider flies down a glide path through gusts that last. State: height error, sink rate, gust."""

    noise_size, steps, start = 1, 80, (0.0, 0.0, 0.0)

    def __init__(self, corridor: float) -> None:
        self.corridor = corridor

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Meet a gust, steer with a limited elevator, move."""
        height, rate, gust = state.T
        gust = 0.95 * gust + math.sqrt(1.0 - 0.95**2) * noise[:, 0]
        action = np.clip(-0.5 * height - 1.2 * rate, -1.5, 1.5)
        return np.stack([height + _DT * rate, rate + _DT * (action - 0.8 * rate + 0.4 * gust), gust], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the height (N,) above the lower edge of the corridor."""
        return state[:, 0] + self.corridor


def systems() -> dict[str, tuple[str, Any]]:
    """Return traits and system of each problem by name."""
    return {
        "following_7m": ("driving, steps", Following(7.0, 0.6)),
        "following_4m": ("driving, steps", Following(4.0, 0.6)),
        "lane_change_2m": ("driving, steps, detections", LaneChange(2.0, -0.6)),
        "lane_change_0m": ("driving, steps, detections", LaneChange(0.0, -0.6)),
        "lane_keeping_80cm": ("driving, steps, two regions", LaneKeeping(0.8)),
        "lane_keeping_92cm": ("driving, steps, two regions", LaneKeeping(0.92)),
        "pedestrian": ("driving, steps, detections", Pedestrian(-1.2)),
        "pedestrian_rare": ("driving, steps, detections", Pedestrian(-1.5)),
        "glider_200cm": ("driving, steps", Glider(2.0)),
        "glider_235cm": ("driving, steps", Glider(2.35)),
        "perching": ("driving, steps, eventually", Perching(0.15)),
    }


def driving_problems() -> Iterator[Problem]:
    """Yield the problems whose truth is kept."""
    kept = json.loads(TRUTHS.read_text(encoding="utf-8")) if TRUTHS.exists() else {}
    for name, (traits, system) in systems().items():
        if name in kept:
            failures, rollouts = kept[name]["failures"], kept[name]["rollouts"]
            p = failures / rollouts
            source = f"brute force, {failures:,} failures in {rollouts:,} rollouts"
            yield stepwise(name, traits, system, p, source, math.sqrt(p * (1.0 - p) / rollouts))
