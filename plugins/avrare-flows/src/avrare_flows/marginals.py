"""Laws of one number, as transforms of a standard normal one: x = F^-1(Phi(z)).

Quantiles take both tail probabilities, P(X <= x) and P(X > x), and use the smaller one: 1 - 1e-20 is 1 in
floating point, and rare events lie beyond. Everything is element by element; parameters may be arrays that
broadcast, so that a simulator can have a different law for each particle.
"""

# ruff: noqa: D102 - ``Marginal`` documents the methods of all laws.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import special

from avrare.base.errors import UsageError
from avrare.protocols import Floats

Number = float | Floats
Tails = tuple[Floats, Floats]
"""P(X <= x) and P(X > x)."""


class Marginal(Protocol):
    """A law of one number; ``from_normal(z)``, if it has one, replaces ``quantile`` of a normal's tails."""

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        """Return the x with P(X <= x) = lower and P(X > x) = upper; the smaller of both is accurate."""

    def tails(self, x: Floats) -> Tails:
        """Return P(X <= x) and P(X > x)."""

    def log_density(self, x: Floats) -> Floats:
        """Return the logarithm of the density, -inf outside the support."""


def from_normal(law: Marginal, z: Floats) -> Floats:
    """Return the physical number of a standard normal one, exact in both tails."""
    if hasattr(law, "from_normal"):
        return np.asarray(law.from_normal(z), dtype=np.float64)
    return law.quantile(special.ndtr(z), special.ndtr(-z))


def to_normal(law: Marginal, x: Floats) -> Floats:
    """Return the standard normal number of a physical one: inverts ``from_normal`` for continuous F."""
    lower, upper = law.tails(x)
    return np.asarray(_by_tail(lower, upper, special.ndtri, lambda p: -special.ndtri(p)))


def _by_tail(
    lower: Floats, upper: Floats, left: Callable[[Floats], Floats], right: Callable[[Floats], Floats]
) -> Floats:
    """Return ``left(lower)`` in the lower half, ``right(upper)`` in the upper one."""
    return np.asarray(np.where(lower <= upper, left(np.minimum(lower, 0.5)), right(np.minimum(upper, 0.5))))


def _positive(law: object, **values: Number) -> None:
    for name, value in values.items():
        if not np.all(np.greater(value, 0.0)):
            raise UsageError(f"{type(law).__name__}: {name} must be positive, not {value!r}")


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal law N(mean, std^2)."""

    mean: Number = 0.0
    std: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, std=self.std)

    def from_normal(self, z: Floats) -> Floats:
        return np.asarray(self.mean + self.std * z)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        return self.from_normal(_by_tail(lower, upper, special.ndtri, lambda p: -special.ndtri(p)))

    def tails(self, x: Floats) -> Tails:
        z = (x - self.mean) / self.std
        return special.ndtr(z), special.ndtr(-z)

    def log_density(self, x: Floats) -> Floats:
        z = (x - self.mean) / self.std
        return np.asarray(-0.5 * z**2 - np.log(self.std * np.sqrt(2.0 * np.pi)))


@dataclass(frozen=True, eq=False)
class LogNormal:
    """Lognormal law: exp of N(mean, std^2)."""

    mean: Number = 0.0
    std: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, std=self.std)

    def from_normal(self, z: Floats) -> Floats:
        return np.exp(self.mean + self.std * z)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        return np.exp(Normal(self.mean, self.std).quantile(lower, upper))

    def tails(self, x: Floats) -> Tails:
        return Normal(self.mean, self.std).tails(_log(x))

    def log_density(self, x: Floats) -> Floats:
        with np.errstate(invalid="ignore"):
            density = Normal(self.mean, self.std).log_density(_log(x)) - _log(x)
        return np.where(np.greater(x, 0.0), density, -np.inf)


@dataclass(frozen=True, eq=False)
class Weibull:
    """Weibull law: scale E^(1/shape), E of law Exp(1); ``shape=1`` is the exponential law."""

    shape: Number = 1.0
    scale: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, shape=self.shape, scale=self.scale)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        unit = _by_tail(lower, upper, lambda p: -np.log1p(-p), lambda p: -_log(p))
        return np.asarray(self.scale * unit ** (1.0 / np.asarray(self.shape)))

    def tails(self, x: Floats) -> Tails:
        unit = (np.maximum(x, 0.0) / self.scale) ** self.shape
        return -np.expm1(-unit), np.exp(-unit)

    def log_density(self, x: Floats) -> Floats:
        ratio = np.maximum(x, 0.0) / self.scale
        steep = special.xlogy(np.asarray(self.shape) - 1.0, ratio)
        density = np.log(np.asarray(self.shape) / self.scale) + steep - ratio**self.shape
        return np.where(np.greater_equal(x, 0.0), density, -np.inf)


@dataclass(frozen=True, eq=False)
class Gamma:
    """Gamma law of mean ``shape * scale``."""

    shape: Number
    scale: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, shape=self.shape, scale=self.scale)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        a = self.shape
        unit = _by_tail(
            lower, upper, lambda p: special.gammaincinv(a, p), lambda p: special.gammainccinv(a, p)
        )
        return np.asarray(self.scale * unit)

    def tails(self, x: Floats) -> Tails:
        unit = np.maximum(x, 0.0) / self.scale
        return special.gammainc(self.shape, unit), special.gammaincc(self.shape, unit)

    def log_density(self, x: Floats) -> Floats:
        unit = np.maximum(x, 0.0) / self.scale
        density = special.xlogy(np.asarray(self.shape) - 1.0, unit) - unit - special.gammaln(self.shape)
        return np.where(np.greater_equal(x, 0.0), density - np.log(self.scale), -np.inf)


@dataclass(frozen=True, eq=False)
class Gumbel:
    """Gumbel law of largest values, F = exp(-exp(-(x - location)/scale))."""

    location: Number = 0.0
    scale: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, scale=self.scale)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        unit = _by_tail(lower, upper, lambda p: -_log(-_log(p)), lambda p: -_log(-np.log1p(-p)))
        return np.asarray(self.location + self.scale * unit)

    def tails(self, x: Floats) -> Tails:
        rate = np.exp(-(x - self.location) / self.scale)
        return np.exp(-rate), -np.expm1(-rate)

    def log_density(self, x: Floats) -> Floats:
        unit = (x - self.location) / self.scale
        return np.asarray(-unit - np.exp(-unit) - np.log(self.scale))


@dataclass(frozen=True, eq=False)
class StudentT:
    """Student's t with location and scale: heavy tails on both sides."""

    freedom: Number
    location: Number = 0.0
    scale: Number = 1.0

    def __post_init__(self) -> None:
        _positive(self, freedom=self.freedom, scale=self.scale)

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        v = self.freedom
        unit = _by_tail(lower, upper, lambda p: _student(v, p), lambda p: -_student(v, p))
        return np.asarray(self.location + self.scale * unit)

    def tails(self, x: Floats) -> Tails:
        unit = (x - self.location) / self.scale
        return special.stdtr(self.freedom, unit), special.stdtr(self.freedom, -unit)

    def log_density(self, x: Floats) -> Floats:
        v, unit = np.asarray(self.freedom), (x - self.location) / self.scale
        constant = special.gammaln(0.5 * (v + 1.0)) - special.gammaln(0.5 * v) - 0.5 * np.log(v * np.pi)
        return np.asarray(constant - 0.5 * (v + 1.0) * np.log1p(unit**2 / v) - np.log(self.scale))


@dataclass(frozen=True, eq=False)
class Uniform:
    """Uniform law on [low, high]."""

    low: Number = 0.0
    high: Number = 1.0

    def __post_init__(self) -> None:
        if not np.all(np.greater(self.high, self.low)):
            raise UsageError(f"Uniform: high ({self.high!r}) must lie above low ({self.low!r})")

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        width = np.asarray(self.high) - self.low
        return _by_tail(lower, upper, lambda p: self.low + p * width, lambda p: self.high - p * width)

    def tails(self, x: Floats) -> Tails:
        width, inside = np.asarray(self.high) - self.low, np.clip(x, self.low, self.high)
        return np.asarray((inside - self.low) / width), np.asarray((self.high - inside) / width)

    def log_density(self, x: Floats) -> Floats:
        inside = np.greater_equal(x, self.low) & np.less_equal(x, self.high)
        return np.where(inside, -np.log(np.asarray(self.high) - self.low), -np.inf)


def _student(freedom: Number, p: Floats) -> Floats:
    """Return Student's quantile for p up to 0.5; SciPy's saturates at tiny p, and changes sign.

    With w = v / (v + x^2), P(X <= x) = I_w(v/2, 1/2) / 2; where 1 - w rounds to 1 it is w^(v/2) / (v B), with
    B = B(v/2, 1/2).
    """
    half = 0.5 * np.asarray(freedom)
    log_w = (_log(2.0 * p) + np.log(half) + special.betaln(half, 0.5)) / half
    negligible = log_w < -40.0  # rounding loses e^-40 beside 1
    with np.errstate(over="ignore"):
        beyond = -np.exp(0.5 * (np.log(2.0 * half) - log_w))
    return np.asarray(np.where(negligible, beyond, special.stdtrit(freedom, np.where(negligible, 0.5, p))))


def Exponential(scale: Number = 1.0) -> Weibull:
    """Return the exponential law of mean ``scale``."""
    return Weibull(1.0, scale)


def _log(x: Any) -> Floats:
    """Return the logarithm, -inf for all numbers up to 0 (outside of a law's support)."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.maximum(x, 0.0)))
