"""Truncated Student-t errors as a monotone transform of a standard normal number.

A lidar detector's errors are heavy-tailed, but a detection is matched to a vehicle only within |error| <=
limit. The tail of a Student-t has no closed form in NumPy; it is tabulated once per number of degrees of
freedom and interpolated by cubic Hermite polynomials: the relative error of a tail is below 1e-8 up to 5
degrees of freedom and below 1e-5 up to 30.

The tails need not be those of a Student-t: of T, the variable sinh(k arcsinh T) / k is near T where T is
small and has tails like |T|^k (Jones and Pewsey 2009, sinh-arcsinh transformation). Below, k is ``power``.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats
from avrare_gp_pem.runtime import normal

_CELLS = 4000


@dataclass(frozen=True)
class HermiteTable:
    """Smooth function on [start, start + step * cells] with cubic Hermite interpolation.

    Attributes:
        start: First node.
        step: Distance between nodes.
        values: Values at the nodes.
        slopes: Derivatives at the nodes.
    """

    start: float
    step: float
    values: Floats
    slopes: Floats

    def __call__(self, x: Floats) -> Floats:
        """Evaluate at ``x``, elementwise; constant outside the nodes."""
        place = np.clip((x - self.start) / self.step, 0.0, len(self.values) - 1.0)
        # any cell will do for a NaN, which the interpolation propagates
        cell = np.minimum(np.where(np.isnan(place), 0.0, place).astype(np.int64), len(self.values) - 2)
        u = place - cell
        v = 1.0 - u
        left = self.values[cell] * (1 + 2 * u) + self.step * u * self.slopes[cell]
        right = self.values[cell + 1] * (1 + 2 * v) - self.step * v * self.slopes[cell + 1]
        value: Floats = v * v * left + u * u * right
        return value


@dataclass(frozen=True)
class StudentT:
    """Student-t with location 0 and scale 1; create it with ``student``.

    Attributes:
        dof: Degrees of freedom.
        tail: Maps arcsinh(t) to -log P(T > t), for t >= 0.
        point: Maps -log P(T > t) to arcsinh(t).
    """

    dof: float
    tail: HermiteTable
    point: HermiteTable

    def log_density(self, t: Floats) -> Floats:
        """Return the log density at ``t``, elementwise."""
        return _log_constant(self.dof) - (self.dof + 1) / 2 * np.log1p(t * t / self.dof)

    def upper_tail(self, t: Floats, power: Floats | float = 1.0) -> Floats:
        """Return P(T > t) for t >= 0, elementwise."""
        return np.exp(-self.tail(np.arcsinh(power * t) / power))

    def draw_truncated(self, noise: Floats, bound: Floats, power: Floats | float = 1.0) -> Floats:
        """Return the value of T given |T| <= bound that has the rank of a standard normal ``noise``.

        Args:
            noise: Standard normal numbers.
            bound: Positive, broadcasts with ``noise``.
            power: Positive, likewise: T^k in the tails.
        """
        beyond = self.upper_tail(bound, power)
        rank = beyond + normal.cdf(-np.abs(noise)) * (1 - 2 * beyond)
        size = np.sinh(power * self.point(-np.log(rank))) / power
        return np.copysign(np.minimum(size, bound), noise)

    def truncated_log_density(self, t: Floats, bound: Floats, power: Floats | None = None) -> Floats:
        """Return the log density at ``t`` of T given |T| <= bound; -inf outside."""
        inside = np.abs(t) <= bound * (1 + 1e-9)  # rounding may put an error at the limit beyond it
        if power is None:
            density = self.log_density(t) - np.log1p(-2 * self.upper_tail(bound))
            return np.where(inside, density, -np.inf)
        root = np.arcsinh(power * t) / power
        jacobian = np.log(np.cosh(root)) - 0.5 * np.log1p((power * t) ** 2)
        density = self.log_density(np.sinh(root)) + jacobian - np.log1p(-2 * self.upper_tail(bound, power))
        return np.where(inside, density, -np.inf)


class Normal:
    """Limit of many degrees of freedom: the functions of ``StudentT``, for a normal law that has no bound."""

    dof = math.inf

    def log_density(self, t: Floats) -> Floats:
        """Return the log density at ``t``, elementwise."""
        return -0.5 * t * t - 0.5 * math.log(2 * math.pi)

    def upper_tail(self, t: Floats, power: Floats | float = 1.0) -> Floats:
        """Return P(T > t) for t >= 0, elementwise."""
        return normal.cdf(-np.sinh(np.arcsinh(power * t) / power))

    def draw_truncated(self, noise: Floats, bound: Floats, power: Floats | float = 1.0) -> Floats:
        """Return the value with the rank of a standard normal ``noise``; ``bound`` is not read."""
        return np.asarray(np.sinh(power * np.arcsinh(noise)) / power)

    def truncated_log_density(self, t: Floats, bound: Floats, power: Floats | None = None) -> Floats:
        """Return the log density at ``t``; ``bound`` is not read."""
        if power is None:
            return self.log_density(t)
        root = np.arcsinh(power * t) / power
        jacobian = np.log(np.cosh(root)) - 0.5 * np.log1p((power * t) ** 2)
        return np.asarray(self.log_density(np.sinh(root)) + jacobian)


def student(dof: float) -> StudentT | Normal:
    """Return the Student-t distribution with ``dof`` degrees of freedom; inf: the normal one."""
    return Normal() if math.isinf(dof) else tabulated_student(float(dof))


@functools.lru_cache(maxsize=16)
def tabulated_student(dof: float) -> StudentT:
    """Return the Student-t distribution with finitely many degrees of freedom, its tables built once."""
    end = 8.0  # the tables reach |t| = sinh(8), about 1490; a larger bound acts like this one
    x = np.linspace(0.0, end, _CELLS + 1)
    step = x[1]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    inside = x[:-1, None] + step * (nodes + 1) / 2
    cells = (_density_of_arcsinh(inside, dof) * weights).sum(axis=1) * step / 2
    s, laguerre = np.polynomial.laguerre.laggauss(16)  # beyond the end the density is near exp(-dof x)
    beyond = (_density_of_arcsinh(end + s / dof, dof) * np.exp(s) * laguerre).sum() / dof
    upper = np.append(np.cumsum(cells[::-1])[::-1], 0.0) + beyond
    tail = HermiteTable(0.0, step, -np.log(upper), _density_of_arcsinh(x, dof) / upper)
    return StudentT(dof, tail, _inverse(tail))


def _density_of_arcsinh(x: Floats, dof: float) -> Floats:
    t = np.sinh(x)
    return np.exp(_log_constant(dof) - (dof + 1) / 2 * np.log1p(t * t / dof)) * np.cosh(x)


def _inverse(tail: HermiteTable) -> HermiteTable:
    y = np.linspace(tail.values[0], tail.values[-1], _CELLS + 1)
    grid = tail.step * np.arange(len(tail.values))
    slope = HermiteTable(tail.start, tail.step, tail.slopes, np.gradient(tail.slopes, tail.step))
    x = np.interp(y, tail.values, grid)
    for _ in range(4):  # Newton steps
        x = np.clip(x - (tail(x) - y) / slope(x), 0.0, grid[-1])
    return HermiteTable(float(y[0]), float(y[1] - y[0]), x, 1.0 / slope(x))


def _log_constant(dof: float) -> float:
    return math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2) - 0.5 * math.log(dof * math.pi)
