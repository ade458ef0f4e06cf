"""Static problems: a transform of normal numbers at t = 0 decides, also of non-Gaussian laws."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from avrare.protocols import Floats, System
from avrare.testing import normal
from avrare.testing.exact_chain_probabilities import panels
from avrare.testing.reference_problem import ReferenceProblem


@dataclass(frozen=True)
class Values:
    """State: the noise of each particle (N, noise_size)."""

    values: Floats


class Static(System):
    """System without dynamics: the noise of t = 0 is the state."""

    def __init__(self, noise_size: int) -> None:
        self.noise_size = noise_size

    def initial(self, noise: Floats) -> Values:
        """Return the noise as state."""
        return Values(noise)

    def step(self, state: Values, noise: Floats) -> Values:
        """Return the state unchanged."""
        return state

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``u0``, ``u1``, ...: one signal (N,) per number."""
        return {f"u{i}": np.ascontiguousarray(column) for i, column in enumerate(state.values.T)}


class Sum(Static):
    """Sum of the normal numbers, scaled to variance 1."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``total`` (N,)."""
        return {"total": row_sum(state.values) / math.sqrt(self.noise_size)}


def row_sum(values: Floats) -> Floats:
    """Add up the columns one after the other, (N,): the bits of a row do not depend on the batch."""
    return np.asarray(sum(values.T[1:], start=values[:, 0]))


class Exponentials(Static):
    """Sum of independent Exp(1), each -log Phi(-u) of a normal number u."""

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``total`` (N,)."""
        return {"total": row_sum(-normal.log_cdf(-state.values))}


class Lognormals(Static):
    """Product of independent exp(sigma u)."""

    def __init__(self, noise_size: int, sigma: float) -> None:
        super().__init__(noise_size)
        self.sigma = sigma

    def signals(self, state: Values) -> dict[str, Floats]:
        """Return ``product`` (N,)."""
        return {"product": np.exp(row_sum(self.sigma * state.values))}


def conjunction(beta: float) -> ReferenceProblem:
    """Return the problem of two failure regions |u0|, u1 >= -beta, for beta < 0 (stl-ess, Eq. 40)."""
    text = f"fails where |u0| and u1 both reach {-beta:g}; p = 2 Phi(beta)^2"
    formula = f"always (abs(u0) < {-beta} or u1 < {-beta})"
    return _problem("conjunction", f"beta={beta:g}", text, Static(2), formula, partial(_conjunction, beta))


def linear(b: float, dim: int = 100) -> ReferenceProblem:
    """Return the problem sum(u) / sqrt(dim) >= b: one failure region in any dimension."""
    text = f"fails where the sum of {dim} normals, over sqrt({dim}), reaches {b:g}; p = Phi(-b)"
    exact = partial(normal.probability, -b)
    return _problem("linear", f"b={b:g}, dim={dim}", text, Sum(dim), f"always (total < {b})", exact)


def four_branch(k: float) -> ReferenceProblem:
    """Return the four-branch series system: four failure regions, two curved and two straight."""
    curved = "3 + 0.1 * pow(u0 - u1, 2) - abs(u0 + u1) / sqrt(2)"
    formula = f"always (min({curved}, {k} / sqrt(2) - abs(u0 - u1)) > 0)"
    text = f"the four-branch series system with k = {k:g}"
    return _problem("four_branch", f"k={k:g}", text, Static(2), formula, partial(_four_branch, k))


def exponential_sum(c: float, dim: int = 10) -> ReferenceProblem:
    """Return the problem that a sum of ``dim`` exponentials reaches ``c`` (Erlang law)."""
    text, formula = f"fails where the sum of {dim} Exp(1) reaches {c:g}", f"always (total < {c})"
    exact = partial(_erlang_tail, c, dim)
    return _problem("exponential_sum", f"c={c:g}, dim={dim}", text, Exponentials(dim), formula, exact)


def lognormal_product(c: float, dim: int = 5, sigma: float = 0.5) -> ReferenceProblem:
    """Return the problem that a product of ``dim`` lognormals reaches ``c``."""
    text = f"fails where the product of {dim} exp({sigma:g} u) reaches {c:g}"
    arguments, formula = f"c={c:g}, dim={dim}, sigma={sigma:g}", f"always (product < {c})"
    exact = partial(normal.probability, -math.log(c) / (sigma * math.sqrt(dim)))
    return _problem("lognormal_product", arguments, text, Lognormals(dim, sigma), formula, exact)


def _problem(
    family: str, arguments: str, text: str, system: Static, formula: str, exact: Callable[[], float]
) -> ReferenceProblem:
    return ReferenceProblem(f"{family}({arguments})", family, text, system, formula, 0, "<=0", exact)


def _conjunction(beta: float) -> float:
    return 2.0 * normal.probability(beta) ** 2


def _four_branch(k: float) -> float:
    # an integral over d = (u0 - u1) / sqrt(2), in coordinates rotated by 45 degrees
    d, weights = panels(np.linspace(0.0, k / 2.0, max(2, math.ceil(k)) + 1))
    curved = 2.0 * normal.cdf(-(3.0 + 0.2 * d**2))
    return 2.0 * float((normal.pdf(d) * curved) @ weights) + 2.0 * normal.probability(-k / 2.0)


def _erlang_tail(c: float, dim: int) -> float:
    return math.fsum(math.exp(j * math.log(c) - c - math.lgamma(j + 1)) for j in range(dim))
