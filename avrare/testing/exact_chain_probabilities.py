"""Exact probabilities of linear Gaussian chains, by integration of their transition density.

The density of the surviving paths is propagated on Gauss-Legendre nodes, and the mass that crosses the level
is added up step by step (flux form): every term is positive, so small probabilities keep their digits.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats
from avrare.testing import normal

_DEVIATIONS = 9.0
"""Half width of the grid in standard deviations: 1e-19 of the mass lies outside."""
_PANEL, _ORDER = 2.0, 16
"""Width of a panel in step scales, and its number of nodes: the error of the rule is far below rounding."""


@dataclass(frozen=True)
class Chain:
    """Linear Gaussian chain x_t = decay x_{t-1} + drift + scale w_t, from x_0 = start."""

    decay: float = 1.0
    drift: float = 0.0
    scale: float = 1.0
    start: float = 0.0

    def density(self, to: Floats, origin: Floats | float) -> Floats:
        """Return the density at ``to`` one step after ``origin`` (the two broadcast)."""
        return normal.pdf((to - self._mean(origin)) / self.scale) / self.scale

    def above(self, level: float, origin: Floats | float) -> Floats:
        """Return P(x_t >= level) one step after ``origin``."""
        return normal.cdf((self._mean(origin) - level) / self.scale)

    def below(self, level: float, origin: Floats | float) -> Floats:
        """Return P(x_t < level) one step after ``origin``."""
        return normal.cdf((level - self._mean(origin)) / self.scale)

    def span(self, steps: int) -> tuple[float, float]:
        """Return the interval that the free chain leaves within ``steps`` with negligible probability."""
        mean, variance, low, high = self.start, 0.0, self.start, self.start
        for _ in range(steps):
            mean, variance = self.decay * mean + self.drift, self.decay**2 * variance + self.scale**2
            low = min(low, mean - _DEVIATIONS * variance**0.5)
            high = max(high, mean + _DEVIATIONS * variance**0.5)
        return low, high

    def grid(self, steps: int, points: Sequence[float], *, above: bool = False) -> tuple[Floats, Floats]:
        """Return nodes and weights (M,) of a rule on the span below the last of ``points``, and ``above`` it.

        ``points`` ascend; panels meet there, so that densities may jump.
        """
        low, high = self.span(steps)
        margin = _DEVIATIONS * self.scale
        points = [min(low, points[0] - margin), *points]
        if above:
            points.append(max(high, points[-1] + margin))
        edges = [
            np.linspace(a, b, int(np.ceil((b - a) / (_PANEL * self.scale))) + 1)
            for a, b in itertools.pairwise(points)
        ]
        return panels(np.unique(np.concatenate(edges)))

    def _mean(self, origin: Floats | float) -> Floats:
        return np.asarray(self.decay * origin + self.drift)


def panels(edges: Floats) -> tuple[Floats, Floats]:
    """Return nodes and weights of the Gauss-Legendre rule on each panel between consecutive ``edges``."""
    nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
    half, middle = np.diff(edges)[:, None] / 2.0, (edges[1:] + edges[:-1])[:, None] / 2.0
    return (middle + half * nodes).ravel(), (half * weights).ravel()


def crossing(chain: Chain, level: float, steps: int) -> float:
    """Return P(max over t = 1..steps of x_t >= level), for level > start."""
    nodes, weights = chain.grid(steps, [level])
    kernel = chain.density(nodes[:, None], nodes) * weights
    passing = chain.above(level, nodes) * weights
    total, density = float(chain.above(level, chain.start)), chain.density(nodes, chain.start)
    for _ in range(steps - 1):
        total += float(passing @ density)
        density = kernel @ density
    return total


def survival(chain: Chain, level: float, steps: int) -> float:
    """Return P(max over t = 1..steps of x_t < level)."""
    nodes, weights = chain.grid(steps, [level])
    kernel = chain.density(nodes[:, None], nodes) * weights
    if steps == 1:
        return float(chain.below(level, chain.start))
    density = chain.density(nodes, chain.start)
    for _ in range(steps - 2):
        density = kernel @ density
    return float((chain.below(level, nodes) * weights) @ density)
