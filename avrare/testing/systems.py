"""Small awkward systems: they count, break down, raise, or keep their state in odd containers.

Plugin authors and the core's own tests run them; all are importable, so that worker processes can build them.
"""

from __future__ import annotations

import multiprocessing
import os
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from avrare.protocols import Bools, Floats, System
from avrare.rollout.request import Integers


class Walk:
    """x += drift + scale w, from 0; the state is a dict."""

    noise_size = 1

    def __init__(self, drift: float = 0.0, scale: float = 0.1) -> None:
        self.drift, self.scale = drift, scale

    def initial(self, noise: Floats) -> Any:
        """All at 0."""
        return {"x": np.zeros(len(noise))}

    def step(self, state: Any, noise: Floats) -> Any:
        """One step."""
        return {"x": self.moved(state["x"], noise)}

    def signals(self, state: Any) -> dict[str, Floats]:
        """``x`` (N,)."""
        return {"x": state["x"]}

    def moved(self, x: Floats, noise: Floats) -> Floats:
        """Where ``x`` (N,) comes to."""
        return x + self.drift + self.scale * noise[:, 0]


@dataclass(frozen=True)
class Inner:
    """A part of ``Nested``."""

    x: Floats


@dataclass(frozen=True)
class Nested:
    """A state of every allowed container, with values that all particles share."""

    inner: Inner
    pair: tuple[Floats, Floats]
    label: str = "car"
    nothing: None = None


class NestedWalk(Walk):
    """A walk whose state is nested."""

    def initial(self, noise: Floats) -> Nested:
        """All at 0."""
        x = np.zeros(len(noise))
        return Nested(Inner(x), (x, np.zeros((len(noise), 2))))

    def step(self, state: Nested, noise: Floats) -> Nested:
        """One step."""
        return Nested(Inner(self.moved(state.inner.x, noise)), state.pair)

    def signals(self, state: Nested) -> dict[str, Floats]:
        """``x`` (N,)."""
        return {"x": state.inner.x}


class Point(NamedTuple):
    """A state that is a named tuple."""

    x: Floats


class TupleWalk(Walk):
    """A walk whose state is a named tuple."""

    def initial(self, noise: Floats) -> Point:
        """All at 0."""
        return Point(np.zeros(len(noise)))

    def step(self, state: Point, noise: Floats) -> Point:
        """One step."""
        return Point(self.moved(state.x, noise))

    def signals(self, state: Point) -> dict[str, Floats]:
        """``x`` (N,)."""
        return {"x": state.x}


class ArrayWalk(Walk):
    """A walk whose state is one array."""

    def initial(self, noise: Floats) -> Floats:
        """All at 0."""
        return np.zeros(len(noise))

    def step(self, state: Floats, noise: Floats) -> Floats:
        """One step."""
        return self.moved(state, noise)

    def signals(self, state: Floats) -> dict[str, Floats]:
        """``x`` (N,)."""
        return {"x": state}


class Counting:
    """Any system, with a count of the ``rows`` that pass through ``step`` in this process."""

    def __init__(self, system: System) -> None:
        self.system, self.noise_size, self.rows = system, system.noise_size, 0

    def initial(self, noise: Floats) -> Any:
        """The system's own."""
        return self.system.initial(noise)

    def step(self, state: Any, noise: Floats) -> Any:
        """The system's own, counted even where it raises."""
        self.rows += len(noise)
        return self.system.step(state, noise)

    def signals(self, state: Any) -> Any:
        """The system's own."""
        return self.system.signals(state)


class Killed(BaseException):
    """As a kill -9 would, it ends a program: nothing in the library may catch it."""


class Mortal:
    """Another system, until it has taken so many batches of steps; then it ends the program.

    Args:
        inner: The system.
        lives: Batches of steps.

    Attributes:
        lived: Batches of steps that it has taken.
    """

    def __init__(self, inner: System, lives: float) -> None:
        self.inner, self.lives, self.lived = inner, lives, 0
        self.noise_size = inner.noise_size

    def initial(self, noise: Floats) -> Any:
        """Of the inner system."""
        return self.inner.initial(noise)

    def step(self, state: Any, noise: Floats) -> Any:
        """Of the inner system, while it lives."""
        if self.lived >= self.lives:
            raise Killed
        self.lived += 1
        return self.inner.step(state, noise)

    def signals(self, state: Any) -> Any:
        """Of the inner system."""
        return self.inner.signals(state)


class Odometer(Walk):
    """A walk whose state counts its own steps, as a planner counts its solves."""

    def initial(self, noise: Floats) -> Any:
        """All at 0."""
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state: Any, noise: Floats) -> Any:
        """One step."""
        return {"x": self.moved(state["x"], noise), "n": state["n"] + 1}

    def counts(self, state: Any) -> dict[str, Integers]:
        """``steps`` (N,)."""
        return {"steps": state["n"]}


class Fragile(Walk):
    """A walk that breaks down where a second noise channel exceeds ``beyond``, whatever its x.

    Args:
        how: "nan" (a signal), "fault" (reported), "raise", or "never".
        beyond: Threshold in standard deviations.
        at_start: Break down at t = 0 or, if not, at any later step.
    """

    noise_size = 2

    def __init__(self, how: str, beyond: float = 2.5, at_start: bool = False) -> None:
        super().__init__()
        self.how, self.beyond, self.at_start = how, beyond, at_start

    @classmethod
    def with_chance(cls, chance: float, at_start: bool = False) -> Fragile:
        """One whose x becomes NaN with a probability, at the start or at each step."""
        return cls("nan", NormalDist().inv_cdf(1.0 - chance), at_start)

    def initial(self, noise: Floats) -> Any:
        """All at 0, unless broken."""
        return self._state(np.zeros(len(noise)), noise, self.at_start)

    def step(self, state: Any, noise: Floats) -> Any:
        """One step, unless broken."""
        return self._state(self.moved(state["x"], noise), noise, not self.at_start)

    def faults(self, state: Any) -> Bools:
        """The broken rows (N,)."""
        return np.asarray(state["bad"] & (self.how == "fault"))

    def _state(self, x: Floats, noise: Floats, now: bool) -> Any:
        bad = (noise[:, 1] > self.beyond) & now
        if self.how == "raise" and bad.any():
            raise RuntimeError("the planner gave up")
        return {"x": np.where(bad & (self.how == "nan"), np.nan, x), "bad": bad}


class Doomed(Walk):
    """A walk in which who comes beyond ``brink`` breaks down at the next step: errors correlate with risk."""

    def __init__(self, brink: float) -> None:
        super().__init__()
        self.brink = brink

    def step(self, state: Any, noise: Floats) -> Any:
        """One step, or NaN beyond the brink."""
        return {"x": np.where(state["x"] > self.brink, np.nan, self.moved(state["x"], noise))}


class Broken(Walk):
    """Raises whatever the row."""

    def step(self, state: Any, noise: Floats) -> Any:
        """Raises."""
        raise ZeroDivisionError("no row survives this")


class Deadly(Walk):
    """Takes its worker process down without a word; does no harm in the main process."""

    def step(self, state: Any, noise: Floats) -> Any:
        """Ends the process, if it is a worker."""
        if multiprocessing.parent_process() is not None:
            os._exit(3)
        return super().step(state, noise)


class Nameless(Walk):
    """Does not offer the signal ``x`` that the formulas read."""

    def signals(self, state: Any) -> dict[str, Floats]:
        """``y`` (N,)."""
        return {"y": state["x"]}


class Homesick(Walk):
    """Pickles, but cannot be read in another process."""

    def __init__(self) -> None:
        super().__init__()
        self.home = os.getpid()

    def __setstate__(self, state: dict[str, Any]) -> None:
        if state["home"] != os.getpid():
            raise RuntimeError("this system lives in one process only")
        self.__dict__ = state


class Infinite(Walk):
    """x is infinite where the noise is positive, y where it exceeds 1: x - y may have no value."""

    def initial(self, noise: Floats) -> Any:
        """Both signals for good."""
        return {name: np.where(noise[:, 0] > limit, np.inf, 0.0) for name, limit in (("x", 0.0), ("y", 1.0))}

    def step(self, state: Any, noise: Floats) -> Any:
        """Nothing moves."""
        return state

    def signals(self, state: Any) -> dict[str, Floats]:
        """``x`` and ``y`` (N,)."""
        return dict(state)


def height(signals: dict[str, Any], t: int) -> Floats:
    """A score: the newest x."""
    return np.asarray(signals["x"][:, t])


def backwards(signals: dict[str, Any], t: int) -> Floats:
    """A score that prefers the rows that will not fail."""
    return -height(signals, t)


def constant(signals: dict[str, Any], t: int) -> Floats:
    """A score that tells nothing."""
    return np.zeros(len(signals["x"]))
