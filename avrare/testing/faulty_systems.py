"""Small awkward systems: they count, raise or report faults; importable, so that worker processes can too."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Bools, Floats, Signals, System, SystemWrapper
from avrare.rollout.child_process import run_here

State = dict[str, NDArray[Any]]


class Walk(System):
    """Walk x += drift + scale w, from 0; the state is a dict."""

    noise_size = 1

    def __init__(self, drift: float = 0.0, scale: float = 0.1) -> None:
        self.drift, self.scale = drift, scale

    def initial(self, noise: Floats) -> State:
        """Start all particles at 0."""
        return {"x": np.zeros(len(noise))}

    def step(self, state: State, noise: Floats) -> State:
        """Advance by one step."""
        return {"x": self.move(state["x"], noise)}

    def signals(self, state: State) -> dict[str, Floats]:
        """Return ``x`` (N,)."""
        return {"x": state["x"]}

    def move(self, x: Floats, noise: Floats) -> Floats:
        """Return the next ``x`` (N,)."""
        return x + self.drift + self.scale * noise[:, 0]


class Counting(SystemWrapper):
    """Wrapper that counts the ``rows`` passed to ``step`` in this process, in which all of it runs."""

    rows = 0

    def __init__(self, system: object) -> None:
        super().__init__(system)
        run_here(self)

    def step(self, state: object, noise: Floats) -> Any:
        """Step the system; rows count even where it raises."""
        self.rows += len(noise)
        return self.system.step(state, noise)


class Killed(BaseException):
    """Stand-in for kill -9: nothing in the library may catch it."""


class Mortal(SystemWrapper):
    """Wrapper that raises ``Killed`` after ``lives`` batches of steps; ``lived`` counts those so far."""

    lived = 0

    def __init__(self, system: object, lives: float) -> None:
        super().__init__(system)
        self.lives = lives

    def step(self, state: object, noise: Floats) -> Any:
        """Step the system, or raise ``Killed``."""
        if self.lived >= self.lives:
            raise Killed
        self.lived += 1
        return self.system.step(state, noise)


class Fragile(Walk):
    """Walk with an error where a second noise channel exceeds ``beyond``, whatever its x.

    Args:
        how: Kind of error: "nan" (a signal), "fault" (reported), "raise", or "never".
        beyond: Threshold in standard deviations.
        at_start: The error occurs at t = 0; if not, at any later step.
    """

    noise_size = 2

    def __init__(self, how: str, beyond: float = 2.5, at_start: bool = False) -> None:
        super().__init__()
        self.how, self.beyond, self.at_start = how, beyond, at_start

    @classmethod
    def with_chance(cls, chance: float, at_start: bool = False) -> Fragile:
        """Return one whose x becomes NaN with probability ``chance``, at the start or at each step."""
        return cls("nan", NormalDist().inv_cdf(1.0 - chance), at_start)

    def initial(self, noise: Floats) -> State:
        """Start all particles at 0, or with an error."""
        return self._state(np.zeros(len(noise)), noise, self.at_start)

    def step(self, state: State, noise: Floats) -> State:
        """Advance by one step, or into an error."""
        return self._state(self.move(state["x"], noise), noise, not self.at_start)

    def faults(self, state: State) -> Bools:
        """Return the rows with a reported fault (N,)."""
        return np.asarray(state["bad"] & (self.how == "fault"))

    def _state(self, x: Floats, noise: Floats, now: bool) -> State:
        bad = (noise[:, 1] > self.beyond) & now
        if self.how == "raise" and bad.any():
            raise RuntimeError("the planner gave up")
        return {"x": np.where(bad & (self.how == "nan"), np.nan, x), "bad": bad}


class Scrambled(System):
    """System whose failures nothing leads to: the last digits of the sum of all noise decide at the end.

    Args:
        steps: Of a rollout.
    """

    noise_size = 1

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def initial(self, noise: Floats) -> Floats:
        """Begin with a sum and a count."""
        return np.stack([noise[:, 0], np.zeros(len(noise))], axis=1)

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Add the noise."""
        return state + np.stack([noise[:, 0], np.ones(len(noise))], axis=1)

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``x``, uniform in (0, 1) at the last step and 2 before."""
        return {"x": np.where(state[:, 1] < self.steps, 2.0, np.mod(1e4 * state[:, 0], 1.0))}


def constant(signals: Signals, t: int) -> Floats:
    """Score without information: the same for all rows."""
    return np.zeros(len(signals["x"]))
