"""Special functions in the standard library: importing SciPy would cost 0.6 s at the start."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray


def beta_cdf(x: float, a: float, b: float) -> float:
    """Return the regularised incomplete beta function I_x(a, b), by Lentz' continued fraction (NR 6.4)."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    if x < (a + 1.0) / (a + b + 2.0):
        return math.exp(log_front) * _continued_fraction(x, a, b) / a
    return 1.0 - math.exp(log_front) * _continued_fraction(1.0 - x, b, a) / b


def _continued_fraction(x: float, a: float, b: float) -> float:
    # A plain loop: a gate of four criteria takes 100,000 of these fractions
    total, c = a + b, 1.0
    d = 1.0 - total * x / (a + 1.0)
    tiny = 1e-300
    result = d = 1.0 / (d if abs(d) > tiny else tiny)
    for m in range(1, 100_000):
        place = a + 2 * m
        even = m * (b - m) * x / ((place - 1) * place)
        d = 1.0 + even * d
        d = 1.0 / (d if abs(d) > tiny else tiny)
        c = 1.0 + even / c
        c = c if abs(c) > tiny else tiny
        result *= c * d
        odd = -(a + m) * (total + m) * x / (place * (place + 1))
        d = 1.0 + odd * d
        d = 1.0 / (d if abs(d) > tiny else tiny)
        c = 1.0 + odd / c
        c = c if abs(c) > tiny else tiny
        factor = c * d
        result *= factor
        if abs(factor - 1.0) < 1e-15:
            break
    return result


def bisect(cdf: Callable[[float], float], target: float, low: float, high: float) -> float:
    """Return the point where an increasing ``cdf`` reaches ``target``, by bisection to the last bit."""
    while True:
        middle = 0.5 * (low + high)
        if middle in (low, high):
            return middle
        if cdf(middle) < target:
            low = middle
        else:
            high = middle


def beta_quantile(q: float, a: float, b: float) -> float:
    """Return the q-quantile of Beta(a, b)."""
    return bisect(lambda x: beta_cdf(x, a, b), q, 0.0, 1.0)


@lru_cache(maxsize=1024)
def t_factor(confidence: float, freedom: float) -> float:
    """Return the t for which Student's t lies in [-t, t] with probability ``confidence``."""
    # P(|T| > t) = I_{f / (f + t^2)}(f / 2, 1 / 2)
    x = beta_quantile(1.0 - confidence, freedom / 2.0, 0.5)
    return math.sqrt(freedom * (1.0 - x) / x)


def normal_factor(confidence: float) -> float:
    """Return the z for which a standard normal lies in [-z, z] with probability ``confidence``."""
    return -NormalDist().inv_cdf((1.0 - confidence) / 2.0)


def uniform_from_normal(normal: float) -> float:
    """Return the number in [0, 1] at which the standard normal distribution function stands at ``normal``."""
    return 0.5 * math.erfc(-normal / math.sqrt(2.0))


def chi_square_quantiles(count: int, freedom: int) -> NDArray[np.float64]:
    """Return the (count,) quantiles (j + 1/2) / count of the chi-square law, by its series and bisection."""
    targets, half = (np.arange(count) + 0.5) / count, freedom / 2.0
    low, high = np.zeros(count), np.full(count, freedom + 40.0 * math.sqrt(2.0 * freedom))
    for _ in range(60):
        middle = 0.5 * (low + high)
        x = middle / 2.0
        term = np.exp(half * np.log(x) - x - math.lgamma(half + 1.0))
        total = term.copy()
        for n in range(1, 400):
            term = term * x / (half + n)
            total += term
        below = total < targets
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))
