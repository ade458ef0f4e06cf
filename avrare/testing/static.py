"""Static problems: all is decided at t = 0 by a transform of normal numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from avrare.protocols import Floats
from avrare.testing import normal
from avrare.testing.chain import panels
from avrare.testing.problem import ReferenceProblem


@dataclass(frozen=True)
class Values:
    """Numbers (N, noise_size) of each particle."""

    values: Floats


class Static:
    """No dynamics: the noise of t = 0 is the state."""

    def __init__(self, noise_size: int) -> None:
        self.noise_size = noise_size

    def initial(self, noise: Floats) -> Values:
        """The noise as it is."""
        return Values(noise)

    def step(self, state: Values, noise: Floats) -> Values:
        """Nothing moves."""
        return state

    def signals(self, state: Values) -> dict[str, Floats]:
        """``u0``, ``u1``, ...: each number (N,)."""
        return {f"u{i}": np.ascontiguousarray(column) for i, column in enumerate(state.values.T)}


class Sum(Static):
    """The normal numbers added up, scaled to variance 1."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """``total`` (N,)."""
        return {"total": row_sum(state.values) / math.sqrt(self.noise_size)}


def row_sum(values: Floats) -> Floats:
    """Sum (N,) over the columns, one after the other: no row's last bit depends on the batch."""
    return np.asarray(sum(values.T[1:], start=values[:, 0]))


def conjunction(beta: float) -> ReferenceProblem:
    """|u0| >= -beta and u1 >= -beta, for beta < 0 (stl-ess, Eq. 40): two separate failure regions."""
    return ReferenceProblem(
        id=f"conjunction(beta={beta:g})",
        family="conjunction",
        text=f"fails where |u0| and u1 both reach {-beta:g}; p = 2 Phi(beta)^2",
        system=Static(2),
        formula=f"always (abs(u0) < {-beta} or u1 < {-beta})",
        steps=0,
        relation="<=0",
        exact=partial(_conjunction, beta),
    )


def linear(b: float, dim: int = 100) -> ReferenceProblem:
    """sum(u) / sqrt(dim) >= b: one failure region in any dimension."""
    return ReferenceProblem(
        id=f"linear(b={b:g}, dim={dim})",
        family="linear",
        text=f"fails where the sum of {dim} normals, over sqrt({dim}), reaches {b:g}; p = Phi(-b)",
        system=Sum(dim),
        formula=f"always (total < {b})",
        steps=0,
        relation="<=0",
        exact=partial(normal.probability, -b),
    )


def four_branch(k: float) -> ReferenceProblem:
    """The series system of four branches: four failure regions, two curved and two straight."""
    curved = "3 + 0.1 * pow(u0 - u1, 2) - abs(u0 + u1) / sqrt(2)"
    return ReferenceProblem(
        id=f"four_branch(k={k:g})",
        family="four_branch",
        text=f"the four-branch series system with k = {k:g}",
        system=Static(2),
        formula=f"always (min({curved}, {k} / sqrt(2) - abs(u0 - u1)) > 0)",
        steps=0,
        relation="<=0",
        exact=partial(_four_branch, k),
    )


def _conjunction(beta: float) -> float:
    return 2.0 * normal.probability(beta) ** 2


def _four_branch(k: float) -> float:
    """In the coordinates turned by 45 degrees: an integral over d = (u0 - u1) / sqrt(2)."""
    d, weights = panels(np.linspace(0.0, k / 2.0, max(2, math.ceil(k)) + 1))
    curved = 2.0 * normal.cdf(-(3.0 + 0.2 * d**2))
    return 2.0 * float((normal.pdf(d) * curved) @ weights) + 2.0 * normal.probability(-k / 2.0)
