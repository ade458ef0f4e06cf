"""Temporal operators as array code: time is axis 0, every other axis is carried along.

A window of any width costs about log2(width) passes over the array, because minimum and maximum do not mind
an element that is counted twice: two windows of 2^k samples, overlapping or not, make the wider one. The same
holds for until, seen as the composition of the maps ``x -> max(p, min(q, x))`` of its samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def shift(x: Array, by: int, fill: Any) -> Array:
    """``y[i] = x[i + by]``, and ``fill`` where that is outside the trace."""
    if by == 0:
        return x
    steps = x.shape[0]
    y = np.full_like(x, fill)
    if 0 < by < steps:
        y[: steps - by] = x[by:]
    elif -steps < by < 0:
        y[-by:] = x[: steps + by]
    return y


def sliding(x: Array, lo: int, hi: float, join: np.ufunc, empty: Any) -> Array:
    """``y[i]`` = join over ``x[i + lo .. i + hi]`` clipped to the trace; ``empty`` where nothing is left.

    Args:
        x: (T, ...).
        lo: First sample of the window, at least 0.
        hi: Last sample of the window, at least ``lo``; may be infinite.
        join: ``np.minimum`` or ``np.maximum``.
        empty: The neutral element of ``join``.
    """
    steps = x.shape[0]
    if lo >= steps:
        return np.full_like(x, empty)
    if hi >= steps - 1:
        y: Array = join.accumulate(x[::-1], axis=0)[::-1]
        return shift(y, lo, empty)
    width, covered = int(hi) - lo + 1, 1
    y = x
    while covered < width:
        by = min(covered, width - covered)
        y = y.copy() if y is x else y
        join(y[:-by], y[by:], out=y[:-by])
        covered += by
    return shift(y, lo, empty)


def until(left: Array, right: Array, lo: int, hi: float, closed: bool, top: Any, bottom: Any) -> Array:
    """``max over k in [i+lo, i+hi] of min(right[k], min of left[i..k])`` clipped to the trace.

    Args:
        left: (T, ...).
        right: (T, ...), same shape.
        lo: First sample where the witness may be.
        hi: Last sample where the witness may be; may be infinite.
        closed: Whether ``left`` must hold at the witness too (else on ``i..k-1`` only).
        top: Value of true.
        bottom: Value of false.
    """
    steps = left.shape[0]
    if lo >= steps:
        return np.full_like(left, bottom)
    width, covered = int(min(hi, steps - 1)) - lo + 1, 1
    p = np.minimum(left, right) if closed else right.copy()
    q = left.copy()
    while covered < width:
        by = min(covered, width - covered)
        np.maximum(p[:-by], np.minimum(q[:-by], p[by:]), out=p[:-by])
        np.minimum(q[:-by], q[by:], out=q[:-by])
        covered += by
    if lo == 0:
        return p
    waiting = sliding(left, 0, lo - 1, np.minimum, top)
    return np.minimum(waiting, shift(p, lo, bottom))
