"""Systems for tests: odd containers of state and errors of every kind; worker processes can import them."""

import multiprocessing
import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from avrare.protocols import Floats
from avrare.testing.faulty_systems import Walk


@dataclass(frozen=True)
class Inner:
    """Part of ``Nested``."""

    x: Floats


@dataclass(frozen=True)
class Nested:
    """State with every allowed container, and values that all particles share."""

    inner: Inner
    pair: tuple[Floats, Floats]
    label: str = "car"
    nothing: None = None


class NestedWalk(Walk):
    """Walk whose state is nested."""

    def initial(self, noise):
        x = np.zeros(len(noise))
        return Nested(Inner(x), (x, np.zeros((len(noise), 2))))

    def step(self, state, noise):
        return Nested(Inner(self.moved(state.inner.x, noise)), state.pair)

    def signals(self, state):
        return {"x": state.inner.x}


class Point(NamedTuple):
    """State that is a named tuple."""

    x: Floats


class TupleWalk(Walk):
    """Walk whose state is a named tuple."""

    def initial(self, noise):
        return Point(np.zeros(len(noise)))

    def step(self, state, noise):
        return Point(self.moved(state.x, noise))

    def signals(self, state):
        return {"x": state.x}


class ArrayWalk(Walk):
    """Walk whose state is one array."""

    def initial(self, noise):
        return np.zeros(len(noise))

    def step(self, state, noise):
        return self.moved(state, noise)

    def signals(self, state):
        return {"x": state}


class Odometer(Walk):
    """Walk whose state counts its own steps, as a planner counts its solves."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state, noise):
        return {"x": self.moved(state["x"], noise), "n": state["n"] + 1}

    def counts(self, state):
        return {"steps": state["n"]}


class Doomed(Walk):
    """Walk with an error at the step after x exceeds ``brink``: errors correlate with risk."""

    def __init__(self, brink):
        super().__init__()
        self.brink = brink

    def step(self, state, noise):
        return {"x": np.where(state["x"] > self.brink, np.nan, self.moved(state["x"], noise))}


class Broken(Walk):
    """Walk that raises in every step."""

    def step(self, state, noise):
        raise ZeroDivisionError("no row survives this")


class Deadly(Walk):
    """Walk that ends its worker process silently; harmless in the main process."""

    def step(self, state, noise):
        if multiprocessing.parent_process() is not None:
            os._exit(3)
        return super().step(state, noise)


class Nameless(Walk):
    """Walk without the signal ``x`` that the formulas read."""

    def signals(self, state):
        return {"y": state["x"]}


class Homesick(Walk):
    """Walk that pickles, but cannot be unpickled in another process."""

    def __init__(self):
        super().__init__()
        self.home = os.getpid()

    def __setstate__(self, state):
        if state["home"] != os.getpid():
            raise RuntimeError("this system lives in one process only")
        self.__dict__ = state


class Infinite(Walk):
    """System whose x is infinite where the noise is positive, y where it exceeds 1: x - y may be NaN."""

    def initial(self, noise):
        return {name: np.where(noise[:, 0] > limit, np.inf, 0.0) for name, limit in (("x", 0.0), ("y", 1.0))}

    def step(self, state, noise):
        return state

    def signals(self, state):
        return dict(state)


def height(signals, t):
    """Score: the current x."""
    return np.asarray(signals["x"][:, t])


def backwards(signals, t):
    """Score that prefers the rows that will not fail."""
    return -height(signals, t)
