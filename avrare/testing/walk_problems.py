"""Walks that must stay below a level, on a lattice above one, reach a goal, or respond in time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from statistics import NormalDist

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats, Signals, System
from avrare.testing.exact_chain_probabilities import Chain, crossing, survival
from avrare.testing.reference_problem import ReferenceProblem

_CLEAR = 0.0
_Paths = Callable[[int, int, int], int]
"""Number of paths of so many steps with so many falls that reach a depth."""


@dataclass(frozen=True)
class Position:
    """State: position of each particle (N,)."""

    x: Floats


class Linear(System):
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
    id, exact = f"{family}(level={level:g}, steps={steps}, {shape})", partial(crossing, chain, level, steps)
    return ReferenceProblem(id, family, text, Linear(chain), f"always (x < {level})", steps, "<=0", exact)


class Lattice(Linear):
    """Lattice walk: x moves by ``rare`` with probability q and by ``common`` otherwise."""

    def __init__(self, q: float, rare: float, common: float) -> None:
        super().__init__(Chain())
        self.threshold = NormalDist().inv_cdf(q)
        self.rare, self.common = rare, common

    def step(self, state: Position, noise: Floats) -> Position:
        """Move each particle once."""
        return Position(state.x + np.where(noise[:, 0] < self.threshold, self.rare, self.common))


def count_down(depth: int, steps: int, q: Fraction | float | str) -> ReferenceProblem:
    """Return a count that falls by 1 with probability ``q`` at each step, or stays; fails at -depth.

    ``q`` is taken exactly: ``"1/10"`` and ``0.1`` differ in the 17th digit.
    """
    return _stays_above("count_down", "or stays", 0.0, depth, steps, Fraction(q), _resting_paths)


def plus_minus(depth: int, steps: int, q: Fraction | float | str) -> ReferenceProblem:
    """Return a walk that falls by 1 with probability ``q`` at each step, or rises by 1; fails at -depth."""
    return _stays_above("plus_minus", "or rises by 1", 1.0, depth, steps, Fraction(q), _rising_paths)


def _stays_above(
    family: str, otherwise: str, up: float, depth: int, steps: int, q: Fraction, paths: _Paths
) -> ReferenceProblem:
    text = f"x falls by 1 with probability {q} at each of {steps} steps, {otherwise}; fails at -{depth}"
    id, formula = f"{family}(depth={depth}, steps={steps}, q={q})", f"always (x + {depth} > 0)"
    system, exact = Lattice(float(q), -1.0, up), partial(_tail, depth, steps, q, paths)
    return ReferenceProblem(id, family, text, system, formula, steps, "<=0", exact)


def _tail(depth: int, steps: int, q: Fraction, paths: _Paths) -> float:
    # exact: rational numbers
    terms = (paths(depth, steps, k) * q**k * (1 - q) ** (steps - k) for k in range(steps + 1))
    return float(sum(terms))


def _resting_paths(depth: int, steps: int, falls: int) -> int:
    return math.comb(steps, falls) if falls >= depth else 0


def _rising_paths(depth: int, steps: int, falls: int) -> int:
    """Count the paths that touch -depth: those that end at or below it and, by reflection, those mirrored."""
    if steps - 2 * falls <= -depth:
        return math.comb(steps, falls)
    mirrored = falls + (steps - 2 * falls + depth)
    return math.comb(steps, mirrored) if mirrored <= steps else 0


@dataclass(frozen=True)
class Lag:
    """Score: the distance of x behind its mean course."""

    drift: float

    def __call__(self, signals: Signals, t: int) -> Floats:
        """Return the score (N,) at step ``t``."""
        return np.asarray(self.drift * t - signals["x"][:, t])


def reach(goal: float, steps: int = 40, drift: float = 0.1, scale: float = 0.2) -> ReferenceProblem:
    """Return a drifting walk that must reach ``goal`` at some t = 1..steps; it fails where it never does."""
    if steps < 1:
        raise UsageError("reach needs steps >= 1")
    chain = Chain(drift=drift, scale=scale)
    id = f"reach(goal={goal:g}, steps={steps}, drift={drift:g}, scale={scale:g})"
    text = f"x += {drift:g} + {scale:g} w from 0; fails where it stays below {goal:g} for {steps} steps"
    formula, exact = f"eventually[1:{steps}] (x >= {goal})", partial(survival, chain, goal, steps)
    return ReferenceProblem(id, "reach", text, Linear(chain), formula, steps, "<0", exact, Lag(drift))


@dataclass(frozen=True)
class Waiting:
    """Score: nearness to the trigger, then 1 and the share of the time limit that has passed.

    Attributes:
        trigger: Value of x that starts the time limit.
        within: Time limit in steps.
        last: Last step at which a trigger counts.
    """

    trigger: float
    within: int
    last: int

    def __call__(self, signals: Signals, t: int) -> Floats:
        """Return the score (N,) at step ``t``; 2 at failure."""
        x, times = signals["x"], np.arange(t + 1)
        cleared = np.where(x <= _CLEAR, times, -1).max(axis=1, keepdims=True)
        pending = (x >= self.trigger) & (times > cleared) & (times <= self.last)
        elapsed = t - pending.argmax(axis=1)
        waiting = 1.0 + np.minimum(elapsed / self.within, 1.0)
        near = np.minimum(0.999, x[:, t] / self.trigger) if t <= self.last else np.full(len(x), -np.inf)
        return np.asarray(np.where(pending.any(axis=1), waiting, near))


def response(
    within: int, steps: int = 100, trigger: float = 2.0, decay: float = 0.9, start: float = 0.5
) -> ReferenceProblem:
    """Return an Ornstein-Uhlenbeck walk that must fall to 0 at most ``within`` steps after ``trigger``."""
    if not (1 <= within < steps and max(start, _CLEAR) < trigger):
        raise UsageError("response needs 1 <= within < steps, and a trigger above 0 and the start")
    chain = Chain(decay, scale=unit_scale(decay), start=start)
    last = steps - within
    id = f"response(within={within}, steps={steps}, trigger={trigger:g}, decay={decay:g}, start={start:g})"
    text = (
        f"x = {decay:g} x + sqrt(1 - {decay:g}^2) w from {start:g} for {steps} steps; fails where it "
        f"comes to {trigger:g} by step {last} and then stays above 0 for {within} steps"
    )
    formula = f"always[0:{last}] ((x >= {trigger}) -> eventually[0:{within}] (x <= {_CLEAR}))"
    exact, score = (
        partial(_integrate_open_triggers, chain, trigger, within, steps),
        Waiting(trigger, within, last),
    )
    return ReferenceProblem(id, "response", text, Linear(chain), formula, steps, "<0", exact, score)


def _integrate_open_triggers(chain: Chain, trigger: float, within: int, steps: int) -> float:
    """Integrate over x and the age of the oldest unanswered trigger.

    ``idle`` is the density of x without a trigger, column j of ``waiting`` that of x > 0 with one of age j.
    """
    nodes, weights = chain.grid(steps, [_CLEAR, trigger], above=True)
    kernel = chain.density(nodes[:, None], nodes) * weights
    lasting = chain.above(_CLEAR, nodes) * weights
    positive, triggered = nodes > _CLEAR, nodes >= trigger
    idle, waiting, total = chain.density(nodes, chain.start), np.zeros((len(nodes), within)), 0.0
    for t in range(1, steps):
        fresh = triggered & (t <= steps - within)
        waiting[:, 0] = np.where(fresh, idle, 0.0)
        total += float(lasting @ waiting[:, -1])
        moved = kernel @ waiting
        idle = kernel @ np.where(fresh, 0.0, idle) + np.where(positive, 0.0, moved.sum(axis=1))
        waiting[:, 1:] = np.where(positive[:, None], moved[:, :-1], 0.0)
    return total
