"""Walks: linear Gaussian chains that must stay below a level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.chain import Chain, crossing
from avrare.testing.problem import ReferenceProblem


@dataclass(frozen=True)
class Position:
    """Where each particle is, (N,)."""

    x: Floats


class Linear:
    """x_t = decay x_{t-1} + drift + scale w_t: a ``Chain`` as a system."""

    noise_size = 1

    def __init__(self, chain: Chain) -> None:
        self.chain = chain

    def initial(self, noise: Floats) -> Position:
        """All particles at the start."""
        return Position(np.full(len(noise), self.chain.start))

    def step(self, state: Position, noise: Floats) -> Position:
        """One step of the chain."""
        chain = self.chain
        return Position(chain.decay * state.x + chain.drift + chain.scale * noise[:, 0])

    def signals(self, state: Position) -> dict[str, Floats]:
        """``x`` (N,)."""
        return {"x": state.x}


def walk(level: float, steps: int = 100, scale: float = 0.1) -> ReferenceProblem:
    """A random walk with steps of standard deviation ``scale`` reaches ``level``, from 0."""
    text = f"x += {scale:g} w from 0 for {steps} steps; fails where x reaches {level:g}"
    return _stays_below("walk", f"scale={scale:g}", text, Chain(scale=scale), level, steps)


def ornstein_uhlenbeck(level: float, steps: int = 100, decay: float = 0.9) -> ReferenceProblem:
    """x_t = decay x_{t-1} + w_t, scaled to a stationary variance of 1, reaches ``level``, from 0."""
    text = (
        f"x = {decay:g} x + sqrt(1 - {decay:g}^2) w from 0 for {steps} steps; fails where x reaches {level:g}"
    )
    chain = Chain(decay, scale=unit_scale(decay))
    return _stays_below("ornstein_uhlenbeck", f"decay={decay:g}", text, chain, level, steps)


def unit_scale(decay: float) -> float:
    """The scale that gives a decaying chain the stationary variance 1."""
    return math.sqrt(1.0 - decay * decay)


def _stays_below(
    family: str, shape: str, text: str, chain: Chain, level: float, steps: int
) -> ReferenceProblem:
    if not (level > chain.start and steps >= 1):
        raise UsageError(f"{family} needs steps >= 1 and a level above {chain.start:g}, where it starts")
    return ReferenceProblem(
        id=f"{family}(level={level:g}, steps={steps}, {shape})",
        family=family,
        text=text,
        system=Linear(chain),
        formula=f"always (x < {level})",
        steps=steps,
        relation="<=0",
        exact=partial(crossing, chain, level, steps),
    )
