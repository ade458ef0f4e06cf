"""A budget holds whatever the score: levels that tie must not cost more than was given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import avrare
from avrare import Problem, stl
from avrare.estimation.plan.budget import Budget
from avrare.protocols import Floats

State = dict[str, Floats]


class Counter:
    """System whose signals are its counters.

    Args:
        noise_size: Numbers of a step.
        advance: Function of counters and noise (N, noise_size) to the next counters.
        names: Names of the counters, which begin at 0; ``t`` is no signal.
    """

    def __init__(self, noise_size: int, advance: Callable[[State, Floats], State], names: str = "n") -> None:
        self.noise_size, self.advance, self.names = noise_size, advance, names

    def initial(self, noise: Floats) -> State:
        return {name: np.zeros(len(noise)) for name in self.names}

    def step(self, state: State, noise: Floats) -> State:
        return self.advance(state, noise)

    def signals(self, state: State) -> State:
        return {name: state[name] for name in self.names if name != "t"}


def _count(up: float, down: float) -> Callable[[State, Floats], State]:
    def advance(state: State, noise: Floats) -> State:
        change = np.where(noise[:, 0] > up, 1.0, np.where(noise[:, 0] < down, -1.0, 0.0))
        return {"n": np.maximum(state["n"] + change, 0.0)}

    return advance


def _match(state: State, noise: Floats) -> State:
    t = state["t"] + 1.0
    sign = np.where((t * 7) % 3 > 0.5, 1.0, -1.0)
    return {"n": np.where((state["n"] == t - 1.0) & (noise[:, 0] * sign > 0.0), t, state["n"]), "t": t}


def _run_length(state: State, noise: Floats) -> State:
    return {"n": np.where(noise[:, 0] > 0.7, state["n"] + 1.0, 0.0)}


def _exceed(state: State, noise: Floats) -> State:
    return {"n": (noise[:, 0] > 4.7) * 1.0}


def _wait(state: State, noise: Floats) -> State:
    return {"b": (noise[:, 0] > 4.1) * 1.0, "g": (noise[:, 1] > 0.25) * 1.0}


def _sum_up(state: State, noise: Floats) -> State:
    return {"n": (noise > 0.3).sum(axis=1) * 1.0}


def lattice_problems() -> dict[str, Problem]:
    """Return the problems by name."""

    def problem(advance: Any, text: str, steps: int, noise_size: int = 1, names: str = "n") -> Problem:
        return Problem(Counter(noise_size, advance, names), stl(text), steps)

    return {
        "walk": problem(_count(0.2, 0.2), "always (n < 18)", 60),
        "drift": problem(_count(0.5, 0.5), "always (n < 14)", 60),
        "queue": problem(_count(0.9, 0.0), "always (n < 14)", 80),
        "code of 16": problem(_match, "always (n < 16)", 20, names="nt"),
        "code of 12": problem(_match, "always (n < 12)", 14, names="nt"),
        "dropouts in a row": problem(_run_length, "always (n < 9)", 60),
        "Boolean": problem(_exceed, "always (n < 0.5)", 20),
        "until": problem(_wait, "(b < 0.5) until[0:30 samples] (g > 0.5)", 30, noise_size=2, names="bg"),
        "sum of a step": problem(_sum_up, "always (n < 13)", 1, noise_size=20),
        "arrivals": problem(_count(0.3, -9.0), "eventually[0:40 samples] (n >= 4)", 40),
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rollouts", "steps"])
@pytest.mark.parametrize("estimator", ["auto", "is", "ams", "ess"])
def test_no_estimate_exceeds_its_budget(estimator, kind):
    for name, problem in lattice_problems().items():
        amount = 6000 * (problem.steps if kind == "steps" else 1)
        result = avrare.estimate(problem, estimator, seed=1, budget=Budget(kind, amount))
        spent = result.simulated_steps if kind == "steps" else result.rollouts
        assert spent <= 1.1 * amount, name
