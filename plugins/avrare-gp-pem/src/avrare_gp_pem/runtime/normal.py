"""Standard normal distribution function in NumPy.

Rational approximations of W. J. Cody, "Rational Chebyshev approximations for the error function",
Mathematics of Computation 23 (1969), 631-637, and a continued fraction beyond 5.7: relative error below 1e-14
down to z = -37.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.protocols import Floats

_INNER_TOP = (
    0.065682337918207449113,
    2.2352520354606839287,
    161.02823106855587881,
    1067.6894854603709582,
    18154.981253343561249,
)
_INNER_BOTTOM = (
    1.0,
    47.20258190468824187,
    976.09855173777669322,
    10260.932208618978205,
    45507.789335026729956,
)
_MIDDLE_TOP = (
    1.0765576773720192317e-8,
    0.39894151208813466764,
    8.8831497943883759412,
    93.506656132177855979,
    597.27027639480026226,
    2494.5375852903726711,
    6848.1904505362823326,
    11602.651437647350124,
    9842.7148383839780218,
)
_MIDDLE_BOTTOM = (
    1.0,
    22.266688044328115691,
    235.38790178262499861,
    1519.377599407554805,
    6485.558298266760755,
    18615.571640885098091,
    34900.952721145977266,
    38912.003286093271411,
    19685.429676859990727,
)
_INNER, _MIDDLE = 0.67448975, 5.656854249492380195
_SQRT_1_2PI = 0.398942280401432677939946
_NEWTON, _LEAST, _MOST = 40, -37.0, 8.0  # beyond them the probability is 0 or 1 in double precision


def cdf(z: Floats) -> Floats:
    """Return P(Z < z) of a standard normal Z, elementwise."""
    size = np.minimum(np.abs(z), 40.0)  # the tail underflows at 40
    tail, far = np.asarray(_rational_tail(np.minimum(size, _MIDDLE))), size >= _MIDDLE
    if far.any():  # rare, and the continued fraction is the slowest part
        tail = np.where(far, _continued_fraction(np.maximum(size, _MIDDLE)), tail)
    outside = np.where(z < 0, tail, 1.0 - tail)
    return np.where(size < _INNER, _central(np.clip(z, -_INNER, _INNER)), outside)


def quantile(log_rank: Floats, start: Floats) -> Floats:
    """Return z in -37 .. 8 with log P(Z < z) = ``log_rank``, elementwise, by Newton's method from ``start``.

    log P is concave, so that every step ends left of the solution, and all further ones climb to it.
    """
    z = np.clip(start, _LEAST, _MOST)
    moving = np.ones(z.shape, dtype=np.bool_)
    for _ in range(_NEWTON):
        rank = cdf(z)
        missing = log_rank - np.log(rank)
        later = np.clip(z + missing * rank / (_SQRT_1_2PI * _density_factor(np.abs(z))), _LEAST, _MOST)
        done = (np.abs(later - z) <= 1e-10) | (np.abs(missing) <= 1e-14)
        z = np.where(moving, later, z)  # a number does not wait for its neighbours
        moving &= ~done
        if not moving.any():
            break
    return np.asarray(z)


def _central(z: Floats) -> Floats:
    square = z * z
    return 0.5 + z * _horner(_INNER_TOP, square) / _horner(_INNER_BOTTOM, square)


def _rational_tail(size: Floats) -> Floats:
    return _density_factor(size) * _horner(_MIDDLE_TOP, size) / _horner(_MIDDLE_BOTTOM, size)


def _continued_fraction(size: Floats) -> Floats:
    fraction = size
    for depth in range(30, 0, -1):
        fraction = size + depth / fraction
    return _SQRT_1_2PI * _density_factor(size) / fraction


def _density_factor(size: Floats) -> Floats:
    coarse = np.trunc(size * 16) / 16  # the square is split so that its rounding does not reach the exponent
    return np.exp(-coarse * coarse / 2) * np.exp(-(size - coarse) * (size + coarse) / 2)


def _horner(coefficients: Sequence[float], x: Floats) -> Floats:
    value = np.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value
