"""Standard normal distribution in NumPy and the standard library."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from benchmarks.calibration.problems.problem import Floats

_NEAR, _TERMS = 2.0, 60
"""Argument of erfc up to which a series is used, and terms of the series and the continued fraction."""


def inverse(p: float) -> float:
    """Return the quantile of p."""
    return NormalDist().inv_cdf(p)


def below(z: Floats) -> Floats:
    """Return P(W <= z), elementwise."""
    return np.exp(log_above(-np.asarray(z, dtype=float)))


def log_above(z: Floats) -> Floats:
    """Return log P(W > z), elementwise, finite in the far tail."""
    x = np.asarray(z, dtype=float) / math.sqrt(2.0)
    near = np.abs(x) < _NEAR
    safe, y = np.where(near, x, 0.0), np.where(near, _NEAR, np.abs(x))
    series, term, fraction = safe.copy(), safe.copy(), np.zeros_like(y)
    for n in range(1, _TERMS):
        term = -term * safe * safe / n
        series += term / (2 * n + 1)
    for n in range(_TERMS, 0, -1):
        fraction = 0.5 * n / (y + fraction)
    tail = -y * y - np.log(2.0 * math.sqrt(math.pi) * (y + fraction))
    far = np.where(x > 0, tail, np.log1p(-np.exp(tail)))
    return np.where(near, np.log(0.5 - series / math.sqrt(math.pi)), far)
