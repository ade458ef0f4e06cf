"""Problems with exact answers: closed forms, sums and integrals, to nine digits or more."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

import avrare


class Walk:
    """x += drift + scale w."""

    noise_size = 1

    def __init__(self, drift=0.0, scale=0.1):
        self.drift, self.scale = drift, scale

    def initial(self, noise):
        return {"x": np.zeros(len(noise))}

    def step(self, state, noise):
        return {"x": state["x"] + self.drift + self.scale * noise[:, 0]}

    def signals(self, state):
        return dict(state)


class Lattice(Walk):
    """x moves by ``other`` with probability q and by ``common`` otherwise: ties at every level."""

    def __init__(self, q, other, common):
        self.threshold = NormalDist().inv_cdf(q)
        self.other, self.common = other, common

    def step(self, state, noise):
        return {"x": state["x"] + np.where(noise[:, 0] < self.threshold, self.other, self.common)}


class Breaking(Walk):
    """A walk whose rows break down at random, whatever their x."""

    noise_size = 2

    def __init__(self, chance, at_start=False):
        super().__init__()
        self.beyond = NormalDist().inv_cdf(1.0 - chance)
        self.at_start = at_start

    def initial(self, noise):
        return {"x": np.where(self.at_start & (noise[:, 1] > self.beyond), np.nan, 0.0)}

    def step(self, state, noise):
        x = super().step(state, noise)["x"]
        return {"x": np.where((not self.at_start) & (noise[:, 1] > self.beyond), np.nan, x)}


class Doomed(Walk):
    """A row that comes beyond ``brink`` breaks down at the next step."""

    def __init__(self, brink):
        super().__init__()
        self.brink = brink

    def step(self, state, noise):
        x = super().step(state, noise)["x"]
        return {"x": np.where(state["x"] > self.brink, np.nan, x)}


class CountingWalk(Walk):
    """Counts the rows that pass through ``step``."""

    rows = 0

    def step(self, state, noise):
        self.rows += len(noise)
        return super().step(state, noise)


class Odometer(Walk):
    """A walk whose state counts its own steps."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state, noise):
        return {**super().step(state, noise), "n": state["n"] + 1}

    def counts(self, state):
        return {"steps": state["n"]}


def lag(signals, t):
    """How far behind schedule: a score for "eventually reaches"."""
    return 0.1 * t - signals["x"][:, t]


def height(signals, t):
    return signals["x"][:, t]


def backwards(signals, t):
    """A score that prefers the rows that will not fail."""
    return -signals["x"][:, t]


def constant(signals, t):
    return np.zeros(len(signals["x"]))


@dataclass(frozen=True)
class Exact:
    system: object
    formula: str
    steps: int
    probability: float
    score: object = None

    def problem(self, **keywords):
        return avrare.Problem(self.system, avrare.stl(self.formula), self.steps, self.score, **keywords)


WALK = Exact(Walk(), "always (x < 2.5)", 100, 1.0618888379037e-2)
RARE_WALK = Exact(Walk(), "always (x < 3.8)", 100, 1.1654634848511e-4)
COUNT_DOWN = Exact(Lattice(0.1, -1, 0), "always (x + 12 > 0)", 40, 3.80834266736e-4)
FEW_LEVELS = Exact(Lattice(0.2, -1, 0), "always (x + 5 > 0)", 9, 0.019581440)
PLUS_MINUS = Exact(Lattice(0.4, -1, 1), "always (x + 14 > 0)", 60, 1.76600931544e-3)
REACH = Exact(Walk(0.1, 0.2), "eventually[1:40] (x >= 0.5)", 40, 8.4429247212e-4, lag)
"""Its prefix robustness rises with time: levels on it would be wrong, and a score of one's own is due."""
