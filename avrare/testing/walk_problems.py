"""Walks: linear Gaussian chains that must stay below a level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.testing.gaussian_chain import Chain, crossing
from avrare.testing.reference_problem import ReferenceProblem


@dataclass(frozen=True)
class Position:
    """State: position of each particle (N,)."""

    x: Floats


class Linear:
    """A ``Chain`` as a system: x_t = decay x_{t-1} + drift + scale w_t."""

    noise_size = 1

    def __init__(self, chain: Chain) -> None:
        self.chain = chain

    def initial(self, noise: Floats) -> Position:
        """Start all particles at ``chain.start``."""
        return Position(np.full(len(noise), self.chain.start))

    def step(self, state: Position, noise: Floats) -> Position:
        """Advance the chain by one step."""
        chain = self.chain
        return Position(chain.decay * state.x + chain.drift + chain.scale * noise[:, 0])

    def signals(self, state: Position) -> dict[str, Floats]:
        """Return ``x`` (N,)."""
        return {"x": state.x}


def walk(level: float, steps: int = 100, scale: float = 0.1) -> ReferenceProblem:
    """Return a random walk with steps of standard deviation ``scale`` from 0; it fails at ``level``."""
    text = f"x += {scale:g} w from 0 for {steps} steps; fails where x reaches {level:g}"
    return _stays_below("walk", f"scale={scale:g}", text, Chain(scale=scale), level, steps)


def ornstein_uhlenbeck(level: float, steps: int = 100, decay: float = 0.9) -> ReferenceProblem:
    """Return x_t = decay x_{t-1} + w_t from 0, scaled to stationary variance 1; it fails at ``level``."""
    text = (
        f"x = {decay:g} x + sqrt(1 - {decay:g}^2) w from 0 for {steps} steps; fails where x reaches {level:g}"
    )
    chain = Chain(decay, scale=unit_scale(decay))
    return _stays_below("ornstein_uhlenbeck", f"decay={decay:g}", text, chain, level, steps)


def unit_scale(decay: float) -> float:
    """Return the scale that gives a decaying chain the stationary variance 1."""
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
