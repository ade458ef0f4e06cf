"""Further problems: outliers, no structure at all, and two static ones for decisions of a gate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.linalg import hadamard
from scipy.stats import chi2, norm

from avrare import Problem, stl
from avrare.protocols import Floats
from avrare.testing.faulty_systems import Scrambled
from avrare.testing.static_problems import row_sum

STEPS = 20


@dataclass(frozen=True)
class Peaks:
    """State: largest noise so far of some channels.

    Attributes:
        largest: (N, K) largest magnitudes of the first K channels.
        energy: (N,) sum of squares of all noise.
    """

    largest: Floats
    energy: Floats


class Outliers:
    """System that remembers outliers of its noise: it fails by two at once, or by the sum of all squares."""

    noise_size = 6

    def initial(self, noise: Floats) -> Peaks:
        """Begin without a memory; the noise of the start counts for nothing."""
        return Peaks(np.zeros((len(noise), 2)), np.zeros(len(noise)))

    def step(self, state: Peaks, noise: Floats) -> Peaks:
        """Remember the largest noise of two channels, and add up the squares."""
        largest = np.maximum(state.largest, np.abs(noise[:, :2]))
        return Peaks(largest, state.energy + (noise * noise).sum(axis=1))

    def signals(self, state: Peaks) -> dict[str, Floats]:
        """Return ``both``, the smaller of two peaks, ``one``, the first, and ``energy``."""
        return {"both": state.largest.min(axis=1), "one": state.largest[:, 0], "energy": state.energy}


def _outliers(formula: str, probability: float) -> tuple[Problem, float]:
    return Problem(Outliers(), stl(formula), STEPS), probability


def _peak(level: float) -> float:
    return float(-np.expm1(STEPS * np.log1p(-2.0 * norm.sf(level))))


def _scrambled(probability: float) -> tuple[Problem, float]:
    return Problem(Scrambled(STEPS), stl(f"always (x > {probability})"), STEPS), probability


class Cubic:
    """Static system whose failures lie beyond a curve of the third degree, in two places."""

    noise_size = 3

    def initial(self, noise: Floats) -> dict[str, Floats]:
        """Decide the rollout."""
        return {"x": noise[:, 1] + 0.12 * noise[:, 0] ** 3 - 0.9 * noise[:, 0]}

    def step(self, state: dict[str, Floats], noise: Floats) -> dict[str, Floats]:
        """Return the same state."""
        return state

    def signals(self, state: dict[str, Floats]) -> dict[str, Floats]:
        """Return ``x``."""
        return state

    @staticmethod
    def probability(level: float) -> float:
        """Return P(x >= level)."""
        return float(quad(lambda u: norm.pdf(u) * norm.sf(level - 0.12 * u**3 + 0.9 * u), -10, 10)[0])


class Modes(Cubic):
    """Static system that fails beyond a level on both sides of eight orthogonal directions: in 16 places."""

    noise_size = 8
    levels = np.linspace(4.0, 4.7, 8)

    def initial(self, noise: Floats) -> dict[str, Floats]:
        """Decide the rollout."""
        along = np.stack([row_sum(noise * direction) for direction in hadamard(8) / 8**0.5], axis=1)
        return {"x": (np.abs(along) / self.levels).max(axis=1)}

    @classmethod
    def probability(cls, level: float) -> float:
        """Return P(x >= level)."""
        return float(-np.expm1(np.log1p(-2.0 * norm.sf(level * cls.levels)).sum()))


CASES: dict[str, Callable[[], tuple[Problem, float]]] = {
    "one_outlier": lambda: _outliers("always (one < 4.4)", _peak(4.4)),
    "two_outliers": lambda: _outliers("always (both < 3.6)", _peak(3.6) ** 2),
    "scrambled_1e-2": lambda: _scrambled(1e-2),
    "scrambled_1e-3": lambda: _scrambled(1e-3),
    "scrambled_1e-4": lambda: _scrambled(1e-4),
    "cubic_4.6": lambda: (Problem(Cubic(), stl("x < 4.6"), 0), Cubic.probability(4.6)),
    "many_modes": lambda: (Problem(Modes(), stl("x < 1"), 0), Modes.probability(1.0)),
    "no_structure": lambda: _outliers("always (energy < 180)", float(chi2.sf(180.0, 6 * STEPS))),
}
