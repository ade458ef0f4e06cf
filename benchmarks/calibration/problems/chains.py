"""Walks, lattices and regimes: step systems whose probabilities are exact."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.calibration.problems.normal import below, inverse
from benchmarks.calibration.problems.problem import Always, Floats, Problem, stepwise

_QUADRATURE, _RATIONAL = "quadrature of the density", "exact rational numbers"
_UNIT = math.sqrt(0.19)
"""Scale that gives x = 0.9 x + scale w the stationary variance 1."""


class Chain(Always):
    """x = decay x + scale w from 0; fails at a level."""

    noise_size = 1
    start = (0.0,)

    def __init__(self, level: float, steps: int, decay: float, scale: float) -> None:
        self.level, self.steps, self.decay, self.scale = level, steps, decay, scale

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move once."""
        return self.decay * state + self.scale * noise

    def margin(self, state: Floats) -> Floats:
        """Return the distance (N,) to the level."""
        return self.level - state[:, 0]


class Lattice(Always):
    """x falls by 1 with probability q and moves by ``otherwise`` else; fails at -depth."""

    noise_size = 1
    start = (0.0,)

    def __init__(self, depth: int, steps: int, q: float, otherwise: float) -> None:
        self.depth, self.steps, self.otherwise = depth, steps, otherwise
        self.threshold = inverse(q)

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move once."""
        return state + np.where(noise < self.threshold, -1.0, self.otherwise)

    def margin(self, state: Floats) -> Floats:
        """Return the steps (N,) above -depth."""
        return state[:, 0] + self.depth


class Reach:
    """x = x + 0.1 + 0.2 w from 0; fails if it never reaches a goal. State: x, largest x, time."""

    noise_size, steps, start = 1, 40, (0.0, -np.inf, 0.0)

    def __init__(self, goal: float) -> None:
        self.goal = goal
        self.formula = f"eventually[1:{self.steps}] (x >= {goal})"

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move once."""
        x = state[:, 0] + 0.1 + 0.2 * noise[:, 0]
        return np.stack([x, np.maximum(state[:, 1], x), state[:, 2] + 1.0], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return how far the goal was passed (N,), known at the end alone."""
        return np.where(state[:, 2] < self.steps, np.inf, state[:, 1] - self.goal)

    def score(self, state: Floats) -> Floats:
        """Return how far x lags behind its mean course, over that of the goal at the end; 1 at failure."""
        most = 0.1 * self.steps - self.goal
        lag = np.minimum((0.1 * state[:, 2] - state[:, 0]) / most, 0.999)
        return np.where(self.margin(state) <= 0.0, 1.0, lag)

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``x`` (N,)."""
        return {"x": state[:, 0]}


class Response:
    """Ornstein-Uhlenbeck walk that must fall to 0 within so many steps of reaching 2. State: x, wait, time.

    The wait is 0 where nothing waits, else 1 + the steps since the oldest unanswered trigger.
    """

    noise_size, steps, start = 1, 100, (0.5, 0.0, 0.0)

    def __init__(self, within: int) -> None:
        self.within, self.last = within, self.steps - within
        self.formula = f"always[0:{self.last}] ((x >= 2.0) -> eventually[0:{within}] (x <= 0))"

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move, answer, trigger."""
        x, t = 0.9 * state[:, 0] + _UNIT * noise[:, 0], state[:, 2] + 1.0
        fresh = (x >= 2.0) & (t <= self.last)
        waiting = np.where(state[:, 1] > 0, state[:, 1] + 1.0, fresh * 1.0)
        return np.stack([x, np.where(x <= 0.0, 0.0, waiting), t], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the distance to the trigger, in [1, ...), or while waiting the share of time left (N,)."""
        near = 1.0 + np.maximum(2.0 - state[:, 0], 0.0) / 2.0
        left = (self.within + 1.0 - state[:, 1]) / self.within
        return np.where(state[:, 1] > 0, left, np.where(state[:, 2] <= self.last, near, 2.0))

    def score(self, state: Floats) -> Floats:
        """Return half way at the trigger, then the share of the wait (N,)."""
        return 1.0 - np.clip(self.margin(state), 0.0, 2.0) / 2.0

    def signals(self, state: Floats) -> dict[str, Floats]:
        """Return ``x`` (N,)."""
        return {"x": state[:, 0]}


class Regimes(Always):
    """Ornstein-Uhlenbeck walk with a hidden regime, whose steps are larger. State: x, wild, time.

    The regime changes by chance, before each step.
    """

    noise_size, steps, start = 2, 40, (0.0, 0.0, 0.0)

    def __init__(self, level: float, calm: float, wild: float, enter: float, leave: float) -> None:
        self.level, self.calm, self.wild, self.enter, self.leave = level, calm, wild, enter, leave

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Change the regime, then move."""
        uniform = below(noise[:, 1])
        wild = np.where(state[:, 1] > 0.5, uniform >= self.leave, uniform < self.enter)
        x = 0.9 * state[:, 0] + np.where(wild, self.wild, self.calm) * noise[:, 0]
        return np.stack([x, wild * 1.0, state[:, 2] + 1.0], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the distance (N,) to the level."""
        return self.level - state[:, 0]


class Coins(Always):
    """Ornstein-Uhlenbeck walk that fails at a level, or at once if two rare coins fall.

    State: x, fallen, time.
    """

    noise_size, steps, start = 3, 100, (0.0, 0.0, 0.0)

    def __init__(self, level: float, coin: float) -> None:
        self.level, self.least = level, -float(inverse(coin))

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Move; toss both coins at the first step."""
        x, t = 0.9 * state[:, 0] + _UNIT * noise[:, 0], state[:, 2]
        fallen = (t == 0.0) & (noise[:, 1:] > self.least).all(axis=1)
        return np.stack([x, np.maximum(state[:, 1], fallen), t + 1.0], axis=1)

    def margin(self, state: Floats) -> Floats:
        """Return the distance (N,) to the level, 0 once the coins have fallen."""
        return np.where(state[:, 1] > 0.0, 0.0, self.level - state[:, 0])


class Outliers(Always):
    """Largest numbers of two channels over 20 steps, both of which must be large to fail. State: both."""

    noise_size, steps, start = 6, 20, (0.0, 0.0)

    def __init__(self, level: float) -> None:
        self.level = level

    def step(self, state: Floats, noise: Floats) -> Floats:
        """Remember the largest."""
        return np.maximum(state, np.abs(noise[:, :2]))

    def margin(self, state: Floats) -> Floats:
        """Return what the lesser of both lacks (N,)."""
        return self.level - state.min(axis=1)


def chain_problems() -> Iterator[Problem]:
    """Yield the chains."""
    for level, p in (
        (2.5, 0.010618888379036615), (3.8, 0.00011654634848510524), (4.8, 1.2225926292977209e-06),
        (5.9, 2.67398695113006e-09),
    ):  # fmt: skip
        yield stepwise(f"walk_{level}", "steps, progress lasts", Chain(level, 100, 1.0, 0.1), p, _QUADRATURE)
    long = Chain(3.9, 1000, 1.0, 1000**-0.5)
    yield stepwise("walk_d1000", "steps, progress lasts", long, 8.931351667478739e-05, _QUADRATURE)
    for level, p in (
        (4.0, 0.0016780051045810328),
        (5.0, 1.7964133614711844e-05),
        (6.0, 6.832111019270873e-08),
    ):
        chain = Chain(level, 100, 0.9, _UNIT)
        yield stepwise(f"ou_{level:.0f}", "steps, progress decays", chain, p, _QUADRATURE)
    both = -math.expm1(math.log1p(-1.7964133614711844e-05) + math.log1p(-1e-4))
    yield stepwise("ou_or_coins", "steps, hidden mode of two numbers", Coins(5.0, 1e-2), both, _QUADRATURE)
    outlier = Chain(4.417163142222428, 20, 0.0, 1.0)
    yield stepwise("one_outlier", "steps, no progress", outlier, 1e-4, "closed form")
    peak = -math.expm1(20 * math.log1p(-2.0 * float(below(np.array(-3.6)))))
    yield stepwise("two_outliers", "steps, two at any time", Outliers(3.6), peak**2, "closed form")
    yield from _lattices()
    for goal, p in (
        (0.25, 0.00028731303291469786),
        (0.5, 0.0008442924721224347),
        (1.0, 0.004218415467302355),
    ):
        yield stepwise(f"reach_{goal}", "steps, eventually", Reach(goal), p, _QUADRATURE)
    for within, p in ((60, 0.0028189748841235237), (80, 0.00029192986568563046)):
        yield stepwise(f"response_{within}", "steps, response", Response(within), p, _QUADRATURE)
    for level, enter, leave, p in (
        (6.333090327932863, 0.02, 0.1, 9.999999999999994e-4), (7.758928093357815, 0.01, 0.2, 1e-5),
    ):  # fmt: skip
        regimes = Regimes(level, 0.3, 0.9, enter, leave)
        yield stepwise(f"regimes_{p:.0e}", "steps, hidden regime", regimes, p, _QUADRATURE)


def _lattices() -> Iterator[Problem]:
    for depth, steps, q, otherwise, p in (
        (12, 40, 0.1, 0.0, 0.00038083426673634236), (15, 40, 0.1, 0.0, 3.48055026700092e-06),
        (9, 9, 0.2, 0.0, 5.12e-07), (4, 20, 0.01, 0.0, 4.262092764244013e-05),
        (5, 20, 0.01, 0.0, 1.367798632893411e-06), (14, 60, 0.4, 1.0, 0.0017660093154436658),
        (18, 60, 0.4, 1.0, 0.00020081264931448548), (14, 100, 0.3, 1.0, 7.043225835557945e-06),
    ):  # fmt: skip
        name = f"{'walk' if otherwise else 'count'}_T{steps}_m{depth}"
        lattice = Lattice(depth, steps, q, otherwise)
        yield stepwise(name, "steps, lattice", lattice, p, _RATIONAL)
