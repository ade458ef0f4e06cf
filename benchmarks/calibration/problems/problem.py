"""Problem: a black box over standard normal numbers, a step system where it is one, and the answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Steps(Protocol):
    """Step system: a state (N, S) that moves by ``noise_size`` standard normal numbers a step.

    Attributes:
        steps: Number of steps T.
        noise_size: Normal numbers of a step.
        start: State before the first step, the same for all.
        formula: What must hold, over ``signals``, in the language of avrare.
    """

    steps: int
    noise_size: int
    start: tuple[float, ...]
    formula: str

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Return the states (N, S) after a step."""

    def margin(self, state: Floats) -> Floats:
        """Return the margins (N,): a rollout fails if one is <= 0 after any of its steps."""

    def score(self, state: Floats) -> Floats:
        """Return how near to failure the states are (N,): at least 1 at failure alone."""

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return what the formula reads."""


class Always:
    """Base of systems that must keep a margin: score and formula follow from it."""

    start: tuple[float, ...]
    formula = "always (margin > 0)"

    def margin(self, state: Floats) -> Floats:
        """Return the margins (N,)."""
        raise NotImplementedError

    def score(self, state: Floats) -> Floats:
        """Return the share (N,) of the first margin that is lost."""
        first = self.margin(np.array([self.start]))[0]
        return 1.0 - self.margin(state) / first

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``margin`` (N,)."""
        return {"margin": self.margin(state)}


@dataclass(frozen=True)
class Problem:
    """A failure with a known probability.

    Attributes:
        name: Name.
        traits: What it tests, a few words each.
        dimension: Number d of standard normal numbers that decide.
        probability: P(robustness <= 0).
        error: Standard error of the probability; 0 where it is exact to nine digits.
        source: How the probability is known.
        robustness: Function of tapes (N, d) to robustness (N,); a failure has robustness <= 0.
        system: The same as a step system, where it is one.
    """

    name: str
    traits: tuple[str, ...]
    dimension: int
    probability: float
    error: float
    source: str
    robustness: Callable[[Floats], Floats] = field(repr=False)
    system: Any = field(default=None, repr=False)


def rolled(system: Any, tapes: Floats) -> Floats:
    """Return the least margin (N,) of rollouts with these tapes (N, T k)."""
    noise = tapes.reshape(len(tapes), system.steps, system.noise_size)
    state = np.tile(np.asarray(system.start, dtype=float), (len(tapes), 1))
    least = np.full(len(tapes), np.inf)
    for t in range(system.steps):
        state = system.step(state, noise[:, t])
        least = np.minimum(least, system.margin(state))
    return least


def stepwise(
    name: str, traits: str, system: Any, probability: float, source: str, error: float = 0.0
) -> Problem:
    """Return the problem of a step system; ``traits`` are separated by commas."""
    return Problem(
        name, tuple(traits.split(", ")), system.steps * system.noise_size, probability, error, source,
        lambda tapes: rolled(system, tapes), system,
    )  # fmt: skip
