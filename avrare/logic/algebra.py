"""What the values of a formula may be: margins, signed margins, truth values, or intervals of them.

Everything else is minimum and maximum, so one evaluator gives robustness, exact Boolean truth and robust
satisfaction intervals.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.formula import Comparison
from avrare.logic.reach import Range, comparison_range

Array = NDArray[Any]

TINY = float(np.finfo(np.float64).tiny)
"""Stands for a margin of 0 that is true, its negative for one that is false; reported as 0.0."""

_TRUE_AT_ZERO = {"<": False, "<=": True, ">": False, ">=": True, "==": True, "!=": False}


def difference(left: Any, right: Any) -> Any:
    """``left - right``, and 0 for equal infinities, which have no margin between them."""
    if type(right) is float and right == 0.0:  # no difference is needed, only a new array
        return np.positive(left, order="C")
    if type(left) is float and left == 0.0:
        return np.negative(right, order="C")
    gap = np.subtract(left, right, order="C")
    if (type(right) is float and math.isfinite(right)) or (type(left) is float and math.isfinite(left)):
        return gap
    if not np.isnan(gap).any():
        return gap
    return np.where(np.isnan(gap) & np.equal(left, right), 0.0, gap)[()]


def flush(values: Array) -> Array:
    """Values with margins of at most ``TINY`` set to 0.0: what users get to see.

    Returns:
        ``values`` itself where there is nothing to do, which tells that there is no NaN among them.
    """
    size = np.abs(values)
    if not size.size or size.item(size.argmin()) > TINY:  # the first NaN, if there is one
        return values
    return np.where(size <= TINY, 0.0, values)


class Robustness:
    """Real margins: positive when true, negative when false (rtamt's reading of ==, iff and xor)."""

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """The shape of a formula's values without trailing axes."""
        return steps, rows

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The value of a comparison of two terms: a new array, or a number."""
        if node.op in (">", ">="):
            return difference(left, right)
        if node.op in ("<", "<="):
            return difference(right, left)
        distance = np.abs(difference(left, right))
        return -distance if node.op == "==" else distance

    def unseen(self, node: Comparison) -> Range:
        """The least and the greatest value of a comparison of which nothing is known."""
        return comparison_range(node)

    def negate(self, x: Array) -> Array:
        """Not x."""
        return np.asarray(np.negative(x))

    def xor(self, left: Array, right: Array) -> Array:
        """Exactly one of the two; its negation is iff."""
        return np.asarray(np.abs(difference(left, right)))

    def xor_range(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """The least and the greatest ``xor`` of values in [a, b] and in [c, d]."""
        least = np.maximum(0.0, np.maximum(difference(a, d), difference(c, b)))
        most = np.maximum(np.abs(difference(a, d)), np.abs(difference(b, c)))
        return least, most

    def ahead(self, x: Array, by: int) -> Array:
        """The values with up to ``by`` samples after the last one, where the trace goes on for ever."""
        return x


class Signed(Robustness):
    """Margins that are never 0: their sign is the truth (``x < 4`` is false at 4).

    Minimum, maximum and negation keep signs; iff and xor do not.
    """

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The margin, or the smallest one of the right sign."""
        value = Robustness.atom(self, node, left, right)
        if np.count_nonzero(value) < value.size:
            return np.where(np.equal(value, 0.0), TINY if _TRUE_AT_ZERO[node.op] else -TINY, value)[()]
        return value

    def unseen(self, node: Comparison) -> Range:
        """The range, with an end of 0 nudged alike."""
        nudge = TINY if _TRUE_AT_ZERO[node.op] else -TINY
        low, high = super().unseen(node)
        return low or nudge, high or nudge


class Truth(Signed):
    """Truth alone: infinity for true, minus infinity for false."""

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The truth of a comparison of two terms; NaN stays NaN."""
        return np.multiply(super().atom(node, left, right), math.inf)

    def unseen(self, node: Comparison) -> Range:
        """Both, unless the terms' ranges tell."""
        low, high = super().unseen(node)
        return low * math.inf, high * math.inf

    def xor(self, left: Array, right: Array) -> Array:
        """Exactly one of the two."""
        return np.asarray(-(left * right))

    def xor_range(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """False and true, unless both sides are known."""
        corners = [self.xor(x, y) for x in (a, b) for y in (c, d)]
        return np.minimum.reduce(corners), np.maximum.reduce(corners)


class Bounds(Robustness):
    """Intervals: axis 1 holds the lower and the upper bound; samples not seen yet may be anything.

    Args:
        exact: What the bounds are of.
        steps: Samples on the grid, seen or not.
        endless: Whether the trace goes on after the grid, repeating its last interval.
    """

    def __init__(self, exact: Robustness, steps: int, endless: bool) -> None:
        self.exact = exact
        self.steps = steps
        self.endless = endless

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """The shape of a formula's intervals without trailing axes."""
        return self.steps, 2, rows

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The exact value where the samples are known, the comparison's range after them."""
        known = self.exact.atom(node, left, right)
        if not isinstance(known, np.ndarray):
            return known
        bounds = np.empty((self.steps, 2, *known.shape[1:]))
        bounds[: len(known)] = known[:, None]
        bounds[len(known) :, 0], bounds[len(known) :, 1] = self.exact.unseen(node)
        return bounds

    def negate(self, x: Array) -> Array:
        """Not x: the bounds change places."""
        return np.asarray(np.negative(x[:, ::-1]))

    def xor(self, left: Array, right: Array) -> Array:
        """The least and the greatest of two intervals."""
        ends = left[:, 0], left[:, -1], right[:, 0], right[:, -1]  # known values have one bound
        return np.stack(self.exact.xor_range(*ends), axis=1)

    def ahead(self, x: Array, by: int) -> Array:
        """The intervals with ``by`` copies of the last one after it, if the trace is endless."""
        return np.concatenate([x, np.repeat(x[-1:], by, axis=0)]) if self.endless and by else x
