"""Temporal operators as array code: time is axis 0, every other axis is carried along.

A window of any width costs about log2(width) passes over the array, because minimum and maximum do not mind
an element that is counted twice: two windows of 2^k samples, overlapping or not, make the wider one. The same
holds for until, seen as the composition of the maps ``x -> max(p, min(q, x))`` of its samples.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_NARROW, _WIDE = 32, 96
"""Numbers per sample below which ``ufunc.accumulate`` is the fastest way along time, from which a loop is."""


def neutral(join: np.ufunc) -> float:
    """The value of ``np.minimum`` or ``np.maximum`` over nothing."""
    return math.inf if join is np.minimum else -math.inf


def other(join: np.ufunc) -> np.ufunc:
    """``np.maximum`` for ``np.minimum`` and the other way round."""
    return np.maximum if join is np.minimum else np.minimum


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


def accumulate(join: np.ufunc, x: Array, own: bool = False) -> Array:
    """``y[i]`` = join over ``x[0 .. i]``, in place if ``x`` is no longer needed."""
    if not len(x) or x[0].size < _NARROW:
        return np.asarray(join.accumulate(x, axis=0))
    y = x if own else x.copy()
    for before, row in itertools.pairwise(y):
        join(before, row, out=row)
    return y


def sliding(x: Array, lo: int, hi: float, join: np.ufunc, own: bool = False) -> Array:
    """``y[i]`` = join over ``x[i + lo .. i + hi]`` clipped to the trace; neutral where nothing is left.

    Args:
        x: (T, ...).
        lo: First sample of the window, at least 0.
        hi: Last sample of the window, at least ``lo``; may be infinite.
        join: ``np.minimum`` or ``np.maximum``.
        own: ``x`` is no longer needed and may be overwritten.
    """
    steps = x.shape[0]
    if lo >= steps:
        return np.full_like(x, neutral(join))
    if hi >= steps - 1 and not _NARROW <= x[0].size < _WIDE:
        return shift(accumulate(join, x[::-1], own)[::-1], lo, neutral(join))
    width, covered = int(min(hi, steps - 1)) - lo + 1, 1
    y, spare = x, None
    while covered < width:
        by = min(covered, width - covered)
        y, spare = _joined(join, y, by, spare), (y if own or y is not x else None)
        covered += by
    return shift(y, lo, neutral(join))


def _joined(join: np.ufunc, x: Array, by: int, out: Array | None) -> Array:
    """``y[i]`` = join of ``x[i]`` and ``x[i + by]``; two arrays in turn, as NumPy copies what overlaps."""
    y = np.empty(x.shape, x.dtype) if out is None else out
    join(x[:-by], x[by:], out=y[:-by])
    y[-by:] = x[-by:]
    return y


def until(left: Array, right: Array, lo: int, hi: float, closed: bool, join: np.ufunc = np.maximum) -> Array:
    """``max over k in [i+lo, i+hi] of min(right[k], min of left[i..k])`` clipped to the trace.

    Args:
        left: (T, ...).
        right: (T, ...), same shape.
        lo: First sample where the witness may be.
        hi: Last sample where the witness may be; may be infinite.
        closed: Whether ``left`` must hold at the witness too (else on ``i..k-1`` only).
        join: ``np.maximum``; ``np.minimum`` gives the dual, with minimum and maximum changing places.
    """
    meet, steps = other(join), left.shape[0]
    if lo >= steps:
        return np.full_like(left, neutral(join))
    width, covered = int(min(hi, steps - 1)) - lo + 1, 1
    p = np.asarray(meet(left, right)) if closed else right.copy()
    q, spare = left, None
    while covered < width:
        by = min(covered, width - covered)
        join(p[:-by], meet(q[:-by], p[by:]), out=p[:-by])
        covered += by
        if covered < width:
            q, spare = _joined(meet, q, by, spare), (None if q is left else q)
    if lo == 0:
        return p
    return np.asarray(meet(sliding(left, 0, lo - 1, meet), shift(p, lo, neutral(join))))
