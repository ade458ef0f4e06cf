"""Problem: a system with a formula, its driving meaning and its exact failure probability."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

import avrare

Floats = NDArray[np.float64]
Values = Floats | NDArray[np.bool_]
State = dict[str, Values]


class Case:
    """A problem; the docstring of each says its driving meaning.

    Attributes:
        formula: Specification.
        method: How the probability is computed.
        steps: Last step; 0 is a static problem.
        noise_size: Standard normal numbers a step.
        start: Values of the state at the start.
        hidden: The failure is a combination without an extreme number, and no score leads there.
    """

    formula: ClassVar[str]
    method: ClassVar[str] = "dynamic programming"
    steps: ClassVar[int] = 0
    noise_size: ClassVar[int] = 1
    start: ClassVar[Mapping[str, ArrayLike]] = {"x": 0.0}
    hidden: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        if "formula" in vars(cls):
            CASES[cls.name()] = cls()

    @classmethod
    def name(cls) -> str:
        """Return the name, words joined by underscores."""
        return re.sub(r"(?<!^)([A-Z])", r"_\1", cls.__name__).lower()

    def initial(self, noise: Floats) -> State:
        """Return the state at the start."""
        return {key: np.full((len(noise), *np.shape(value)), value) for key, value in self.start.items()}

    def step(self, state: State, noise: Floats) -> State:
        """Return the next state."""
        raise NotImplementedError

    def signals(self, state: State) -> State:
        """Return what the formula reads."""
        return state

    def exact(self) -> float:
        """Return the failure probability."""
        raise NotImplementedError

    def problem(self) -> avrare.Problem:
        """Return the problem with default options."""
        return avrare.Problem(self, avrare.stl(self.formula), self.steps)


CASES: dict[str, Case] = {}
"""The problems by name."""


class Static(Case):
    """A problem without time, whose state at the start has its signals."""

    method = "quadrature"

    def step(self, state: State, noise: Floats) -> State:
        """Return the same state."""
        return state


def threshold(probability: float) -> float:
    """Return the number that a standard normal one exceeds with the probability."""
    return float(norm.isf(probability))


def switch(on: Values, noise: Floats, enter: float, leave: float) -> Values:
    """Return a regime's next state, given the probabilities to enter and to leave it."""
    return np.where(on, noise <= threshold(leave), noise > threshold(enter))
