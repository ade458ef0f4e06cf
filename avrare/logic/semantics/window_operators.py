"""Temporal operators as array code: time is axis 0, all other axes are carried along.

A window of any width costs about log2(width) passes over the array instead of the queue of Lemire's sliding
minimum: minimum and maximum are idempotent, so two windows of 2^k samples, overlapping or not, give the wider
one. Until works alike (see ``fold_until``).
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

_NARROW, _WIDE = 32, 96
"""Numbers per sample: below the first ``ufunc.accumulate`` is fastest, from the second on a loop is."""


def get_neutral(join: np.ufunc) -> float:
    """Return the value of ``np.minimum`` or ``np.maximum`` over no operands."""
    return math.inf if join is np.minimum else -math.inf


def get_dual(join: np.ufunc) -> np.ufunc:
    """Return ``np.maximum`` for ``np.minimum`` and vice versa."""
    return np.maximum if join is np.minimum else np.minimum


def shift(x: Array, by: int, fill: float) -> Array:
    """Return ``y[i] = x[i + by]``, and ``fill`` outside the trace."""
    if by == 0:
        return x
    steps = x.shape[0]
    y = np.full_like(x, fill)
    if 0 < by < steps:
        y[: steps - by] = x[by:]
    elif -steps < by < 0:
        y[-by:] = x[: steps + by]
    return y


def accumulate(join: np.ufunc, x: Array, overwrite: bool = False) -> Array:
    """Return the join of ``x[0 .. i]`` for every i; overwrites ``x`` if ``overwrite``."""
    if not len(x) or x[0].size < _NARROW:
        return np.asarray(join.accumulate(x, axis=0))
    y = x if overwrite else x.copy()
    for before, row in itertools.pairwise(y):
        join(before, row, out=row)
    return y


def slide(x: Array, lo: int, hi: float, join: np.ufunc, overwrite: bool = False) -> Array:
    """Return the join of ``x[i + lo .. i + hi]``, clipped to the trace (stl-ams, Eq. 14), for every i.

    ``x`` is (T, ...), and overwritten if ``overwrite``; 0 <= lo <= hi, which may be infinite.
    """
    steps = x.shape[0]
    # 1. Empty and unbounded windows need no doubling.
    if lo >= steps:
        return np.full_like(x, get_neutral(join))
    if hi >= steps - 1 and not _NARROW <= x[0].size < _WIDE:
        return shift(accumulate(join, x[::-1], overwrite)[::-1], lo, get_neutral(join))
    # 2. Double the window, y[i] = join of x[i .. i + covered - 1], until it has the whole width.
    width, covered = int(min(hi, steps - 1)) - lo + 1, 1
    y, spare = x, None
    while covered < width:
        by = min(covered, width - covered)
        y, spare = _join_shift(join, y, by, spare), (y if overwrite or y is not x else None)
        covered += by
    # 3. Move it to its offset.
    return shift(y, lo, get_neutral(join))


def _join_shift(join: np.ufunc, x: Array, by: int, out: Array | None) -> Array:
    # x[i] with x[i + by]; into a separate array, as NumPy copies operands that overlap.
    y = np.empty(x.shape, x.dtype) if out is None else out
    join(x[:-by], x[by:], out=y[:-by])
    y[-by:] = x[-by:]
    return y


def fold_until(
    left: Array, right: Array, lo: int, hi: float, closed: bool, join: np.ufunc = np.maximum
) -> Array:
    """Return ``max over k in [i+lo, i+hi] of min(right[k], min of left[i..k])``, clipped to the trace.

    Each sample is the map ``x -> max(p, min(q, x))`` of the value at the next sample. The maps are closed
    under composition, ``p = max(p1, min(q1, p2))`` and ``q = min(q1, q2)``, and double like windows.

    Args:
        left: (T, ...).
        right: (T, ...), same shape.
        lo: First sample of the witness.
        hi: Last sample of the witness; may be infinite.
        closed: True if ``left`` must hold at the witness too (else on ``i..k-1`` only).
        join: ``np.maximum``; ``np.minimum`` gives the dual (release), with minimum and maximum swapped.
    """
    meet, steps = get_dual(join), left.shape[0]
    if lo >= steps:
        return np.full_like(left, get_neutral(join))
    # 1. Maps of single samples.
    width, covered = int(min(hi, steps - 1)) - lo + 1, 1
    p = np.asarray(meet(left, right)) if closed else right.copy()
    q, spare = left, None
    # 2. Compose each map with the one ``covered`` samples later.
    while covered < width:
        by = min(covered, width - covered)
        join(p[:-by], meet(q[:-by], p[by:]), out=p[:-by])
        covered += by
        if covered < width:
            q, spare = _join_shift(meet, q, by, spare), (None if q is left else q)
    # 3. Move to the offset, where left must hold on the samples before it too.
    if lo == 0:
        return p
    return np.asarray(meet(slide(left, 0, lo - 1, meet), shift(p, lo, get_neutral(join))))
