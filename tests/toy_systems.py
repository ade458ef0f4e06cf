"""Small systems whose failure probabilities are known; importable, so that workers can build them."""

import multiprocessing
import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

WALK = {2.5: 1.0618888379037e-2, 3.8: 1.1654634848511e-4}
"""P(max over t = 1..100 of x_t >= L) for x += 0.1 w: numerical integration, eleven digits."""


class Walk:
    noise_size = 1

    def initial(self, noise):
        return {"x": np.zeros(len(noise))}

    def step(self, state, noise):
        return {"x": state["x"] + 0.1 * noise[:, 0]}

    def signals(self, state):
        return {"x": state["x"]}


@dataclass(frozen=True)
class Position:
    x: np.ndarray


@dataclass(frozen=True)
class Nested:
    inner: Position
    pair: tuple
    label: str = "car"
    nothing: None = None


class DataclassWalk(Walk):
    def initial(self, noise):
        x = np.zeros(len(noise))
        return Nested(Position(x), (x, np.zeros((len(noise), 2))))

    def step(self, state, noise):
        return Nested(Position(state.inner.x + 0.1 * noise[:, 0]), state.pair)

    def signals(self, state):
        return {"x": state.inner.x}


class Point(NamedTuple):
    x: np.ndarray


class TupleWalk(Walk):
    def initial(self, noise):
        return Point(np.zeros(len(noise)))

    def step(self, state, noise):
        return Point(state.x + 0.1 * noise[:, 0])

    def signals(self, state):
        return {"x": state.x}


class ArrayWalk(Walk):
    def initial(self, noise):
        return np.zeros(len(noise))

    def step(self, state, noise):
        return state + 0.1 * noise[:, 0]

    def signals(self, state):
        return {"x": state}


class CountingWalk(Walk):
    """Counts the rows that pass through ``step``."""

    def __init__(self):
        self.rows = 0

    def step(self, state, noise):
        self.rows += len(noise)
        return super().step(state, noise)


class Odometer(Walk):
    """A walk whose state counts its own steps, as a planner counts its solves."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state, noise):
        return {"x": state["x"] + 0.1 * noise[:, 0], "n": state["n"] + 1}

    def counts(self, state):
        return {"steps": state["n"]}


class Static:
    """No dynamics: all is decided at t = 0. P(x >= 2) = 0.0227501319481792."""

    noise_size = 3

    def initial(self, noise):
        return {"x": noise.sum(axis=1) / np.sqrt(3.0)}

    def step(self, state, noise):
        raise AssertionError("a static problem has no steps")

    def signals(self, state):
        return {"x": state["x"]}


class Fragile(Walk):
    """A walk that breaks down where a second noise channel exceeds ``beyond``, in one of three ways."""

    noise_size = 2

    def __init__(self, how, beyond=2.5, at_start=False):
        self.how, self.beyond, self.at_start = how, beyond, at_start

    def initial(self, noise):
        return self._broken(np.zeros(len(noise)), noise) if self.at_start else self._state(noise[:, 0] * 0.0)

    def step(self, state, noise):
        x = state["x"] + 0.1 * noise[:, 0]
        return self._state(x) if self.at_start else self._broken(x, noise)

    def _state(self, x):
        return {"x": x, "bad": np.zeros(len(x), dtype=bool)}

    def _broken(self, x, noise):
        bad = noise[:, 1] > self.beyond
        if self.how == "raise" and bad.any():
            raise RuntimeError("the planner gave up")
        return {"x": np.where(bad & (self.how == "nan"), np.nan, x), "bad": bad}

    def faults(self, state):
        return state["bad"] & (self.how == "fault")


class Broken(Walk):
    """Raises whatever the row."""

    def step(self, state, noise):
        raise ZeroDivisionError("no row survives this")


class Deadly(Walk):
    """Takes its worker process down without a word; does no harm in the main process."""

    def step(self, state, noise):
        if multiprocessing.parent_process() is not None:
            os._exit(3)
        return super().step(state, noise)


class Nameless(Walk):
    """Does not offer the signal that the formulas read."""

    def signals(self, state):
        return {"y": state["x"]}


class Homesick(Walk):
    """Pickles, but cannot be read in another process."""

    def __init__(self):
        self.home = os.getpid()

    def __setstate__(self, state):
        if state["home"] != os.getpid():
            raise RuntimeError("this system lives in one process only")
        self.__dict__ = state


class Infinite(Walk):
    """x is infinite where the noise is positive, y where it exceeds 1: their difference may have no value."""

    def initial(self, noise):
        return {
            "x": np.where(noise[:, 0] > 0.0, np.inf, 0.0),
            "y": np.where(noise[:, 0] > 1.0, np.inf, 0.0),
        }

    def step(self, state, noise):
        return state

    def signals(self, state):
        return dict(state)


def height(signals, t):
    """A score function: the newest x."""
    return signals["x"][:, t]
