"""Adapter of avrare: the formula of a step system as a user would write it, static problems as one signal."""

from __future__ import annotations

import warnings
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

import avrare
from benchmarks.calibration.answer import Answer, Counted, NoAnswerError
from benchmarks.calibration.problems.problem import Floats

STATIC = "always (robustness > 0)"


class System:
    """A counted problem as a system of avrare: its own steps, or none."""

    def __init__(self, counted: Counted) -> None:
        self.counted, self.own = counted, counted.problem.system
        self.noise_size = self.own.noise_size if self.own else counted.problem.dimension

    def initial(self, noise: Floats) -> Floats:
        """Start; a static problem is decided here."""
        if self.own:
            return np.tile(np.asarray(self.own.start, dtype=float), (len(noise), 1))
        return self.counted.robustness(noise)[:, None]

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move once."""
        return self.counted.step(state, noise)

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return what the formula reads."""
        if self.own:
            found: dict[str, Floats] = self.own.signals(state)
            return found
        return {"robustness": state[:, 0]}


def tool_version() -> str:
    """Return the version of avrare, from its package or its tree."""
    try:
        return version("avrare")
    except PackageNotFoundError:
        return str(getattr(avrare, "__version__", "tree"))


def estimate(method: str, counted: Counted, budget: int, seed: int, options: dict[str, Any]) -> Answer:
    """Return avrare's answer; the budget is its option ``rollouts``, or where it has none one of steps."""
    own = counted.problem.system
    steps = own.steps if own else 0
    problem = avrare.Problem(System(counted), avrare.stl(own.formula if own else STATIC), steps)
    given: dict[str, Any] = {"seed": seed, **options}
    if method in ("mc", "is", "auto"):
        given["rollouts"] = budget
    else:
        given["budget"] = {"steps": float(budget * steps)} if steps else {"rollouts": float(budget)}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = avrare.estimate(problem, method, **given)
    except avrare.AvrareError as error:
        raise NoAnswerError(str(error)) from error
    low, high = result.interval
    return Answer(float(result.probability), (float(low), float(high)), tuple(result.health))
