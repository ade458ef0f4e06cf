"""Noise that is not normal: exponentials and lognormals, as transforms of normal numbers."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from avrare.protocols import Floats
from avrare.testing import normal
from avrare.testing.problem import ReferenceProblem
from avrare.testing.static import Static, Values, row_sum


class Exponentials(Static):
    """The sum of independent Exp(1), each -log Phi(-u) of a normal number u."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """``total`` (N,)."""
        return {"total": row_sum(-normal.log_cdf(-state.values))}


class Lognormals(Static):
    """The product of independent exp(sigma u)."""

    def __init__(self, noise_size: int, sigma: float) -> None:
        super().__init__(noise_size)
        self.sigma = sigma

    def signals(self, state: Values) -> dict[str, Floats]:
        """``product`` (N,)."""
        return {"product": np.exp(row_sum(self.sigma * state.values))}


def exponential_sum(c: float, dim: int = 10) -> ReferenceProblem:
    """The sum of ``dim`` exponentials reaches ``c``: Erlang's law."""
    return ReferenceProblem(
        id=f"exponential_sum(c={c:g}, dim={dim})",
        family="exponential_sum",
        text=f"fails where the sum of {dim} Exp(1) reaches {c:g}",
        system=Exponentials(dim),
        formula=f"always (total < {c})",
        steps=0,
        relation="<=0",
        exact=partial(_erlang_tail, c, dim),
    )


def lognormal_product(c: float, dim: int = 5, sigma: float = 0.5) -> ReferenceProblem:
    """The product of ``dim`` lognormals reaches ``c``."""
    return ReferenceProblem(
        id=f"lognormal_product(c={c:g}, dim={dim}, sigma={sigma:g})",
        family="lognormal_product",
        text=f"fails where the product of {dim} exp({sigma:g} u) reaches {c:g}",
        system=Lognormals(dim, sigma),
        formula=f"always (product < {c})",
        steps=0,
        relation="<=0",
        exact=partial(normal.probability, -math.log(c) / (sigma * math.sqrt(dim))),
    )


def _erlang_tail(c: float, dim: int) -> float:
    return math.fsum(math.exp(j * math.log(c) - c - math.lgamma(j + 1)) for j in range(dim))
