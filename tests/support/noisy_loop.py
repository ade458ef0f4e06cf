"""Closed loop with exact derivatives: the position is the sum of what a sensor saw; importable by workers."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from types import SimpleNamespace
from typing import Any

import numpy as np

import avrare
from avrare.stack.closed_loop import ClosedLoop

NORMAL = NormalDist()


@dataclass(frozen=True)
class Line:
    x: Any
    ego: Any = None


class Adder:
    """Simulator: x += action."""

    dt, noise_size = 0.1, 0

    def reset(self, noise):
        return Line(np.zeros(len(noise)))

    def step(self, world, action, noise):
        return Line(world.x + action)

    def signals(self, world):
        return {"x": world.x}


class Drawn:
    """Start with two drawn options that change nothing."""

    size, noise_names = 2, ("draw of gap", "draw of speed")

    def reset(self, noise):
        return Line(np.zeros(len(noise))), None


class Sensor:
    """Perception: sees sd times the noise."""

    noise_size = 1

    def __init__(self, sd):
        self.sd = sd

    def observe(self, world, noise):
        return self.sd * noise[:, 0]

    def log_ratio(self, world, noise, memory, other, other_memory):
        z, factor = noise[:, 0], self.sd / other.sd
        return np.log(factor) + 0.5 * z * z * (1.0 - factor**2), None


class Last:
    """Tracker: the last observation."""

    def start(self, world):
        return np.zeros_like(world.x)

    def update(self, track, observation):
        return observation

    def predict(self, track, steps):
        return track


class Gain:
    """Controller: gain times the prediction."""

    horizon = 1

    def __init__(self, gain=1.0):
        self.gain = gain

    def start(self, n):
        return np.zeros(n)

    def act(self, memory, ego, prediction):
        return self.gain * prediction, memory


STEPS, LIMIT = 5, 4.0


def noisy_problem(sd=1.0, gain=1.0, limit=LIMIT, start=None):
    """Return a problem that fails where gain * sd * (sum of STEPS - 1 normals) ends beyond the limit."""
    loop = ClosedLoop(Adder(), Sensor(sd), Last(), Gain(gain), start)
    return avrare.Problem(loop, avrare.stl(f"always[{STEPS}, {STEPS} samples] (x < {limit})"), STEPS)


def exact(scale=1.0, limit=LIMIT):
    """Return probability and d log p / d scale, for scale = gain * sd."""
    spread = (STEPS - 1) ** 0.5
    beta = limit / (scale * spread)
    p = 1.0 - NORMAL.cdf(beta)
    return SimpleNamespace(p=p, derivative=NORMAL.pdf(beta) * beta / scale / max(p, 1e-300))
