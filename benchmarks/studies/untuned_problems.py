"""Problems with exact answers that no estimator was tuned on, each with a trap that real stacks hold.

Most are made of independent modes: each has a Gaussian chain that fails above a level, and a signal
that rises to its limit in some shape. The specification fails where any signal reaches its limit, so the
probability follows from those of the chains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from statistics import NormalDist

import numpy as np

from avrare import Problem, stl
from avrare.base.special_functions import bisect
from avrare.protocols import Floats, System
from avrare.testing.exact_chain_probabilities import Chain, crossing, survival
from benchmarks.unseen.problems.exact import loss, panels

STEPS = 20
_WALK = Chain(scale=STEPS**-0.5)
_OU = Chain(decay=0.9, scale=0.19**0.5)
_OUTLIER = Chain(decay=0.0)
_LOWEST = -20.0
"""Least position of a chain with regimes, to integrate from."""


def linear(x: Floats, level: float) -> Floats:
    """Rise evenly from 0 at x = 0 to 1 at the level."""
    return x / level


def late(x: Floats, level: float) -> Floats:
    """Stay near 0 until shortly before the level."""
    return np.exp(np.minimum(4.0 * (x - level), 50.0))


def flat(x: Floats, level: float) -> Floats:
    """Show nothing before the level."""
    return np.where(x >= level, 1.1, 0.0)


def misleading(x: Floats, level: float) -> Floats:
    """Fall until 0.7 of the level, and rise from there to 1 at the level."""
    share = x / level
    return np.where(
        share < 0.7, 0.3 - 0.4 * np.abs(share), -0.4 + 1.4 * (share - 0.7) / 0.3 - 1e-12 * (share < 1)
    )


Shape = Callable[[Floats, float], Floats]


@dataclass(frozen=True)
class Mode:
    """A way to fail.

    Attributes:
        probability: Probability of this way alone.
        chain: Its hidden state.
        shape: Function from state and level to the signal, 1 at the level.
        unit: Factor of the signal.
    """

    probability: float
    chain: Chain = _WALK
    shape: Shape = linear
    unit: float = 1.0

    def level(self, steps: int) -> float:
        """Return the level that the chain reaches with the probability."""
        return bisect(lambda x: self.probability - crossing(self.chain, x, max(steps, 1)), 0.0, 0.1, 12.0)


@dataclass(frozen=True)
class Chains:
    """State of M chains.

    Attributes:
        x: (N, M) states.
    """

    x: Floats


class Modes(System):
    """System of independent modes, with signals ``s0``, ``s1``, ...

    Args:
        modes: Ways to fail.
        steps: Number of steps; 0 draws every chain once.
        idle: Further noise numbers a step, which nothing reads.
        boolean: Signals are 1.0 at failure and 0.0 elsewhere.
    """

    def __init__(self, modes: tuple[Mode, ...], steps: int, idle: int = 0, boolean: bool = False) -> None:
        self.modes, self.static, self.boolean = modes, steps == 0, boolean
        self.noise_size = len(modes) + idle
        self.levels = [mode.level(steps) for mode in modes]
        self.decay, self.drift, self.scale, self.start = (
            np.array([getattr(mode.chain, name) for mode in modes])
            for name in ("decay", "drift", "scale", "start")
        )

    def initial(self, noise: Floats) -> Chains:
        """Start every chain."""
        start = Chains(np.tile(self.start, (len(noise), 1)))
        return self.step(start, noise) if self.static else start

    def step(self, state: Chains, noise: Floats) -> Chains:
        """Advance every chain."""
        used = noise[:, : len(self.modes)]
        return Chains(self.decay * state.x + self.drift + self.scale * used)

    def signals(self, state: Chains) -> dict[str, Floats]:
        """Return the signal (N,) of every mode."""
        signals = {}
        for i, (mode, level) in enumerate(zip(self.modes, self.levels, strict=True)):
            x = state.x[:, i]
            signals[f"s{i}"] = (x >= level) * 1.0 if self.boolean else mode.unit * mode.shape(x, level)
        return signals


@dataclass(frozen=True)
class Hidden:
    """State with a part that no formula reads.

    Attributes:
        x: (N,) position.
        wild: (N,) 1.0 in the wild regime.
    """

    x: Floats
    wild: Floats


class Regimes(System):
    """A chain with two step sizes, which change at random or are drawn at the start.

    Args:
        calm: Chain of the calm regime.
        wild: Chain of the wild one.
        at_start: Probability of the wild regime at the start.
        enter: Probability a step that calm becomes wild.
        leave: Probability a step that wild becomes calm.
    """

    noise_size = 2

    def __init__(
        self, calm: Chain, wild: Chain, at_start: float, enter: float = 0.0, leave: float = 0.0
    ) -> None:
        self.calm, self.wild = calm, wild
        self.at_start, self.enter, self.leave = at_start, enter, leave
        self.starts_below, self.enters_below, self.leaves_below = map(_quantile, (at_start, enter, leave))

    def initial(self, noise: Floats) -> Hidden:
        """Draw the regime."""
        wild = noise[:, 1] < self.starts_below
        return Hidden(np.where(wild, self.wild.start, self.calm.start), wild * 1.0)

    def step(self, state: Hidden, noise: Floats) -> Hidden:
        """Change the regime, then move."""
        change = noise[:, 1]
        wild = np.where(state.wild > 0.5, change >= self.leaves_below, change < self.enters_below)
        calm_x, wild_x = (
            chain.decay * state.x + chain.drift + chain.scale * noise[:, 0]
            for chain in (self.calm, self.wild)
        )
        return Hidden(np.asarray(np.where(wild, wild_x, calm_x)), wild * 1.0)

    def signals(self, state: Hidden) -> dict[str, Floats]:
        """Return ``x`` (N,); the regime is hidden."""
        return {"x": state.x}

    def crossing(self, level: float, steps: int) -> float:
        """Return P(max over t = 1..steps of x_t >= level), by integration over position and regime."""
        chains = (self.calm, self.wild)

        def density(x: Floats, before: Floats, regime: int) -> Floats:
            chain = chains[regime]
            return chain.density(x, before if before.ndim else chain.start)

        grid = panels(_LOWEST, level, min(chain.scale for chain in chains))
        switches = ((1.0 - self.enter, self.enter), (self.leave, 1.0 - self.leave))
        return loss(density, grid, steps, switches, (1.0 - self.at_start, self.at_start))


def _quantile(probability: float) -> float:
    return NormalDist().inv_cdf(probability) if probability > 0.0 else -math.inf


@dataclass(frozen=True)
class Untuned:
    """A problem with its exact probability.

    Attributes:
        name: Name.
        trap: What it tests.
        system: The system.
        formula: Specification.
        steps: Number of steps; 0: static.
        probability: Exact failure probability.
        blind: Part of the probability that the score does not lead to.
    """

    name: str
    trap: str
    system: System = field(repr=False)
    formula: str
    steps: int
    probability: float
    blind: float = 0.0

    def problem(self) -> Problem:
        """Return the problem as a user would write it, with default options."""
        return Problem(self.system, stl(self.formula), self.steps)


def _modes(
    name: str, trap: str, *modes: Mode, steps: int = STEPS, idle: int = 0, blind: float = 0.0
) -> Untuned:
    system = Modes(modes, steps, idle)
    conjuncts = " and ".join(f"s{i} < {mode.unit:g}" for i, mode in enumerate(modes))
    probability = 1.0 - float(np.prod([1.0 - mode.probability for mode in modes]))
    formula = f"always ({conjuncts})" if steps else conjuncts
    return Untuned(name, trap, system, formula, steps, probability, blind)


def _boolean(name: str, formula: str, level: float, drift: float) -> Untuned:
    chain = Chain(drift=drift, scale=STEPS**-0.5)
    system = Modes((Mode(0.5, chain),), STEPS, boolean=True)
    system.levels = [level]
    probability = (survival if "eventually" in formula else crossing)(chain, level, STEPS)
    return Untuned(name, "Boolean signal", system, formula, STEPS, probability)


def _regimes(name: str, trap: str, system: Regimes, probability: float, steps: int = 40) -> Untuned:
    level = bisect(lambda x: probability - system.crossing(x, steps), 0.0, 0.5, 15.0)
    return Untuned(name, trap, system, f"always (x < {level!r})", steps, system.crossing(level, steps))


def untuned_problems() -> dict[str, Untuned]:
    """Return all problems by name; to find their levels takes a minute."""
    return {name: untuned_problem(name) for name in untuned_names()}


def untuned_names() -> tuple[str, ...]:
    """Return the names of the problems; those of static problems begin with "static"."""
    return tuple(_recipes())


@cache
def untuned_problem(name: str) -> Untuned:
    """Return the problem of this name."""
    return _recipes()[name]()


@cache
def _recipes() -> dict[str, partial[Untuned]]:
    calm, wild = Chain(decay=0.9, scale=0.3), Chain(decay=0.9, scale=0.9)
    many = Chain(decay=0.9, scale=0.19**0.5)
    hidden = Regimes(many, Chain(decay=0.9, scale=4 * 0.19**0.5), 3e-4)
    moved = Regimes(many, Chain(decay=0.9, scale=0.19**0.5, start=3.0), 1e-3)
    rare, flat_mode, late_mode = Mode(3e-5), Mode(2e-4, _WALK, flat), Mode(3.4e-4, _WALK, late)
    recipes = [
        partial(_modes, "units_100", "units", Mode(2e-4, _OU), Mode(2e-4, _OU, unit=100)),
        partial(_modes, "units_1e4", "units", Mode(2e-4), Mode(2e-4, unit=1e4)),
        partial(_modes, "units_three", "units", Mode(3e-4, unit=30), Mode(1e-4, _OU), Mode(1e-4, unit=1e-3)),
        partial(_modes, "units_rare", "units", Mode(1e-5, _OU), Mode(3e-4, _OU, unit=300)),
        partial(_modes, "units_outlier", "units", Mode(1e-4, _OUTLIER, unit=50), Mode(1e-4)),
        partial(_modes, "static_units", "units", Mode(1e-4), Mode(1e-4, unit=1e3), steps=0),
        partial(_modes, "flat", "flat mode", rare, flat_mode, blind=2e-4),
        partial(_modes, "flat_outlier", "flat mode", rare, Mode(2e-4, _OUTLIER, flat), blind=2e-4),
        partial(_modes, "static_flat", "flat mode", rare, flat_mode, steps=0, blind=2e-4),
        partial(_modes, "static_flat_20", "flat mode", rare, flat_mode, steps=0, idle=18, blind=2e-4),
        partial(_modes, "late", "late-rising mode", Mode(1.3e-5), late_mode),
        partial(_modes, "late_ou", "late-rising mode", Mode(3e-5, _OU), Mode(1e-3, _OU, late)),
        partial(_modes, "static_late", "late-rising mode", Mode(1.3e-5), late_mode, steps=0),
        partial(_modes, "static_rare_1e-3", "late-rising mode", Mode(3e-5), Mode(1e-3, _WALK, late), steps=0),
        partial(_modes, "static_rare_1e-4", "late-rising mode", Mode(3e-5), Mode(1e-4, _WALK, late), steps=0),
        partial(_modes, "misleading", "score that falls first", Mode(3e-5), Mode(1e-4, _WALK, misleading)),
        partial(_modes, "unequal", "unequal modes", Mode(1.6e-4), Mode(3e-5)),
        partial(_modes, "unequal_four", "unequal modes", Mode(1e-4), Mode(5e-5), Mode(2e-5), Mode(1e-5)),
        partial(_modes, "static_unequal", "unequal modes", Mode(1.6e-4), Mode(3e-5), steps=0),
        partial(_modes, "static_unequal_10", "unequal modes", Mode(2e-4), Mode(2e-5), steps=0, idle=8),
        partial(_modes, "outliers", "one outlier in one step", Mode(1e-4, _OUTLIER)),
        partial(_modes, "outlier_walk", "one outlier in one step", Mode(1e-4, _OUTLIER), Mode(1e-4)),
        partial(_modes, "plain_walk", "none", Mode(1e-5)),
        partial(_modes, "plain_ou", "none", Mode(1e-4, _OU)),
        partial(_modes, "static_plain_50", "none", Mode(1e-5), steps=0, idle=49),
        partial(_regimes, "regimes_1e-3", "hidden regime", Regimes(calm, wild, 0.0, 0.02, 0.1), 1e-3),
        partial(_regimes, "regimes_1e-5", "hidden regime", Regimes(calm, wild, 0.0, 0.01, 0.2), 1e-5),
        partial(_regimes, "hidden_scale", "hidden start", hidden, 2.5e-4),
        partial(_regimes, "hidden_start", "hidden start", moved, 1e-4),
        partial(_boolean, "boolean_eventually", "eventually (s0 >= 1)", 1.0, 0.25),
        partial(_boolean, "boolean_above", "eventually (s0 > 0.5)", 1.0, 0.22),
        partial(_boolean, "boolean_always", "always (s0 < 0.5)", 3.4, 0.0),
    ]
    return {recipe.args[0]: recipe for recipe in recipes}
