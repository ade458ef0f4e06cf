"""Standard normal distribution on arrays, in NumPy alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.polynomial import polyval

from avrare.protocols import Floats

# W. J. Cody, "Rational Chebyshev approximations for the error function", Math. Comp. 23 (1969): numerator
# and denominator, lowest power first, of erf(y)/y in y^2 up to 0.46875, of exp(y^2) erfc(y) in y up to 4, and
# of the correction to its asymptote in 1/y^2 beyond.
_NEAR = (
    (
        3.20937758913846947e3,
        3.77485237685302021e2,
        1.13864154151050156e2,
        3.16112374387056560,
        1.85777706184603153e-1,
    ),
    (2.84423683343917062e3, 1.28261652607737228e3, 2.44024637934444173e2, 2.36012909523441209e1, 1.0),
)
_MIDDLE = (
    (1.23033935479799725e3, 2.05107837782607147e3, 1.71204761263407058e3, 8.81952221241769090e2,
     2.98635138197400131e2, 6.61191906371416295e1, 8.88314979438837594, 5.64188496988670089e-1,
     2.15311535474403846e-8),
    (1.23033935480374942e3, 3.43936767414372164e3, 4.36261909014324716e3, 3.29079923573345963e3,
     1.62138957456669019e3, 5.37181101862009858e2, 1.17693950891312499e2, 1.57449261107098347e1, 1.0),
)  # fmt: skip
_FAR = (
    (6.58749161529837803e-4, 1.60837851487422766e-2, 1.25781726111229246e-1, 3.60344899949804439e-1,
     3.05326634961232344e-1, 1.63153871373020978e-2),
    (2.33520497626869185e-3, 6.05183413124413191e-2, 5.27905102951428412e-1, 1.87295284992346725,
     2.56852019228982242, 1.0),
)  # fmt: skip


def pdf(x: Floats) -> Floats:
    """Return the standard normal density at ``x``."""
    return np.asarray(np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi))


def cdf(x: Floats) -> Floats:
    """Return P(W <= x) of a standard normal W, elementwise, to full precision in both tails."""
    return np.asarray(np.where(x < 0.0, _tail(-x), 1.0 - _tail(x)))


def probability(x: float) -> float:
    """Return ``cdf`` of one number."""
    return float(cdf(np.asarray(x)))


def log_cdf(x: Floats) -> Floats:
    """Return log P(W <= x), finite down to the far left tail."""
    left = -0.5 * x**2 + np.log(0.5 * _scaled_erfc(np.abs(x) / np.sqrt(2.0)))
    return np.asarray(np.where(x < 0.0, left, np.log1p(-_tail(np.maximum(x, 0.0)))))


def _tail(x: Floats) -> Floats:
    # P(W >= x) for x >= 0; finite, but meaningless, for x < 0.
    y = np.abs(x) / np.sqrt(2.0)
    return np.asarray(0.5 * np.exp(-(y**2)) * _scaled_erfc(y))


def _scaled_erfc(y: Floats) -> Floats:
    # This is exp(y^2) erfc(y), for y >= 0.
    small, inverse = np.minimum(y, 0.46875), 1.0 / np.maximum(y, 4.0)
    near = np.exp(small**2) * (1.0 - small * _ratio(_NEAR, small**2))
    middle = _ratio(_MIDDLE, np.clip(y, 0.46875, 4.0))
    far = inverse * (5.6418958354775628695e-1 - inverse**2 * _ratio(_FAR, inverse**2))  # 1 / sqrt(pi)
    return np.asarray(np.where(y <= 0.46875, near, np.where(y <= 4.0, middle, far)))


def _ratio(terms: tuple[Sequence[float], Sequence[float]], x: Floats) -> Floats:
    return np.asarray(polyval(x, terms[0]) / polyval(x, terms[1]))
