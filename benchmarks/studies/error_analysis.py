"""Error analysis of nested levels (stl-ess, section IV-C): variances as in Eq. 21-22, tails as in Eq. 28.

It assumes K fixed levels with independent samples, which a run of chains does not have: for the variance,
effective numbers of samples take their place; the tail bounds are for planning only. An interval comes from
independent runs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from avrare.base.errors import UsageError


def relative_variance(shares: ArrayLike, samples: ArrayLike) -> float:
    """Return that of a product of shares (Eq. 21): prod(1 + (1 - p_k) / (n_k p_k)) - 1.

    Args:
        shares: (K,) in (0, 1].
        samples: (K,) or one number: independent samples, or the chains' ``effective_sizes``.

    Raises:
        UsageError: A share is not in (0, 1].
    """
    p = np.asarray(shares, dtype=np.float64)
    if not ((p > 0.0) & (p <= 1.0)).all():
        raise UsageError("shares must lie in (0, 1]")
    return float(np.expm1(np.log1p((1.0 - p) / (np.asarray(samples) * p)).sum()))


def nominal_relative_variance(levels: int, samples: int, share: float = 0.5) -> float:
    """Return that of K levels of the same share (Eq. 22 over p^2; at 1/2: (1 + 1/N)^K - 1)."""
    return relative_variance(np.full(levels, share), samples)


def overestimate_bound(factor: float, levels: int, samples: int, least_share: float = 0.5) -> float:
    """Bound P(estimate >= factor x truth) (Eq. 28): exp(-2 d^2 log(factor)^2 N / K).

    Args:
        factor: > 1.
        levels: K.
        samples: N at each level.
        least_share: d, lower bound of all levels' true shares; unknown in a run.

    Raises:
        UsageError: The factor is at most 1.
    """
    return math.exp(-2.0 * (least_share * _log(factor)) ** 2 * samples / levels)


def underestimate_bound(factor: float, levels: int, samples: int, least_share: float = 0.5) -> float:
    """Bound P(estimate <= truth / factor), the unsafe side, which Eq. 28 does not cover.

    With y = p/q - 1 of a level, log(1 + y) >= y - a y^2 where y >= -h, for a = 1 / (2 (1 - h)^2). y is
    sub-Gaussian with proxy v = 1 / (4 N d^2) (Hoeffding), so that E exp(-s y + s a y^2) is at most
    (1 - 2 s a v)^(-1/2) exp(s^2 v / 2 / (1 - 2 s a v)). That some y < -h has at most probability
    K exp(-2 N d^2 h^2). The sum of both is minimised over h and s.

    Args:
        factor: > 1.
        levels: K.
        samples: N at each level.
        least_share: d, as in ``overestimate_bound``.

    Raises:
        UsageError: The factor is at most 1.
    """
    wanted, v = _log(factor), 1.0 / (4.0 * samples * least_share**2)
    h = np.linspace(0.02, 0.98, 97)[:, None]
    a = 0.5 / (1.0 - h) ** 2
    used = np.linspace(0.002, 0.998, 499)  # of the range of s, up to 1 / (2 a v)
    s, left = used / (2.0 * a * v), 1.0 - used
    tail = -s * wanted - 0.5 * levels * np.log(left) + 0.5 * levels * s**2 * v / left
    outside = math.log(levels) - 2.0 * samples * (least_share * h) ** 2
    return min(1.0, float(np.exp(np.logaddexp(tail, outside).min())))


def _log(factor: float) -> float:
    if not factor > 1.0:
        raise UsageError(f"the factor must lie above 1, not {factor!r}")
    return math.log(factor)
