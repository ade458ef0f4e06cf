"""Lattice walks: scores tie at every level, up to whole populations."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from statistics import NormalDist

import numpy as np

from avrare.protocols import Floats
from avrare.testing.gaussian_chain import Chain
from avrare.testing.reference_problem import ReferenceProblem
from avrare.testing.walk_problems import Linear, Position


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
    return _stays_above("count_down", "or stays", depth, steps, Fraction(q), _resting_paths)


def plus_minus(depth: int, steps: int, q: Fraction | float | str) -> ReferenceProblem:
    """Return a walk that falls by 1 with probability ``q`` at each step, or rises by 1; fails at -depth."""
    return _stays_above("plus_minus", "or rises by 1", depth, steps, Fraction(q), _rising_paths)


def _stays_above(
    family: str, otherwise: str, depth: int, steps: int, q: Fraction, paths: Callable[[int, int, int], int]
) -> ReferenceProblem:
    text = f"x falls by 1 with probability {q} at each of {steps} steps, {otherwise}; fails at -{depth}"
    return ReferenceProblem(
        id=f"{family}(depth={depth}, steps={steps}, q={q})",
        family=family,
        text=text,
        system=Lattice(float(q), -1.0, 1.0 if paths is _rising_paths else 0.0),
        formula=f"always (x + {depth} > 0)",
        steps=steps,
        relation="<=0",
        exact=partial(_tail, depth, steps, q, paths),
    )


def _tail(depth: int, steps: int, q: Fraction, paths: Callable[[int, int, int], int]) -> float:
    # exact: rational numbers
    return float(
        sum(paths(depth, steps, falls) * q**falls * (1 - q) ** (steps - falls) for falls in range(steps + 1))
    )


def _resting_paths(depth: int, steps: int, falls: int) -> int:
    return math.comb(steps, falls) if falls >= depth else 0


def _rising_paths(depth: int, steps: int, falls: int) -> int:
    """Count the paths that touch -depth: those that end at or below it and, by reflection, those mirrored."""
    if steps - 2 * falls <= -depth:
        return math.comb(steps, falls)
    mirrored = falls + (steps - 2 * falls + depth)
    return math.comb(steps, mirrored) if mirrored <= steps else 0
