"""A system of outliers: peaks of channels, and an error that lasts."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

import avrare
from avrare.testing.faulty_systems import Mortal

STEPS = 8


@dataclass(frozen=True)
class Peaks:
    first: np.ndarray
    second: np.ndarray
    energy: np.ndarray
    total: np.ndarray
    drift: np.ndarray


class Outliers:
    """Peaks of two of three channels, the sum of all squares, that of all noise, and an error that lasts."""

    noise_size = 3
    noise_names = ("gust", "glare", "rattle")
    dt = 0.5

    def initial(self, noise):
        zeros = np.zeros(len(noise))
        return Peaks(zeros, zeros, zeros, zeros, noise[:, 2])

    def step(self, state, noise):
        first, second = np.abs(noise[:, :2].T)
        energy = state.energy + (noise * noise).sum(axis=1)
        total = state.total + noise.sum(axis=1)
        drift = 0.8 * state.drift + 0.6 * noise[:, 2]  # of variance 1, from the start on
        return Peaks(np.maximum(state.first, first), np.maximum(state.second, second), energy, total, drift)

    def signals(self, state):
        return {
            "first": state.first,
            "second": state.second,
            "energy": state.energy,
            "both": np.minimum(state.first, state.second),
            "digits": 1000.0 * state.total % 1.0,
            "drift": np.abs(state.drift),
        }


def peak(level, steps=STEPS):
    return -np.expm1(steps * np.log1p(-2.0 * norm.sf(level)))


def outliers(formula, steps=STEPS, chunk=4096, lives=np.inf):
    return avrare.Problem(Mortal(Outliers(), lives), avrare.stl(formula), steps, chunk=chunk)


def wide(channel, step, scale=2.5):
    return (channel, step, step, 1.0, 0.0, 0.0, scale)
