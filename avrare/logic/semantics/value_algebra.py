"""Value algebras: robustness, robustness whose sign is the truth, and intervals of these.

Temporal and Boolean operators are minimum and maximum in every algebra, so one evaluator computes robustness,
exact Boolean truth and robust satisfaction intervals.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from avrare.logic.semantics.window_operators import Array
from avrare.logic.syntax.nodes import Arithmetic, Call, Comparison, Negative, Number, Term

Range = tuple[float, float]
Value = Array | float
"""Values of a term: an array, or a number where it reads no signal."""

TINY = float(np.finfo(np.float64).tiny)
"""Represents a margin of 0 that is true, its negative one that is false; reported as 0.0."""

_TRUE_AT_ZERO = {"<": False, "<=": True, ">": False, ">=": True, "==": True, "!=": False}


def subtract(left: Value, right: Value) -> Any:
    """Return ``left - right``, and 0 for equal infinities, which have no margin between them."""
    if type(right) is float and right == 0.0:  # no subtraction is needed, only a new array
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
    """Set values of magnitude at most ``TINY`` to 0.0, for output.

    Returns:
        ``values`` itself if nothing is flushed, which implies that none of them is NaN.
    """
    size = np.abs(values)
    if not size.size or size.item(size.argmin()) > TINY:  # argmin finds the first NaN, if there is one
        return values
    return np.where(size <= TINY, 0.0, values)


class RobustnessAlgebra:
    """Real margins: positive when true, negative when false (rtamt's reading of ==, iff and xor).

    Attributes:
        lead: Number of axes of values before those of vehicles: time, N.
    """

    lead = 2

    def compare(self, node: Comparison, left: Value, right: Value) -> Any:
        """Return the value of a comparison of two terms: a new array, or a number."""
        if node.op in (">", ">="):
            return subtract(left, right)
        if node.op in ("<", "<="):
            return subtract(right, left)
        distance = np.abs(subtract(left, right))
        return -distance if node.op == "==" else distance

    def bound_unseen_samples(self, node: Comparison) -> Range:
        """Return the range of a comparison of samples not seen yet."""
        return _bound_margin(node)

    def negate(self, x: Array) -> Array:
        """Return not x."""
        return np.asarray(np.negative(x))

    def xor(self, left: Array, right: Array) -> Array:
        """Return the exclusive or; its negation is iff."""
        return np.asarray(np.abs(subtract(left, right)))

    def xor_range(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """Return the range of ``xor`` over values in [a, b] and [c, d]."""
        least = np.maximum(0.0, np.maximum(subtract(a, d), subtract(c, b)))
        most = np.maximum(np.abs(subtract(a, d)), np.abs(subtract(b, c)))
        return least, most

    def ahead(self, x: Array, by: int) -> Array:
        """Return the values extended by ``by`` samples, if the trace is endless."""
        return x


class SignedAlgebra(RobustnessAlgebra):
    """Margins that are never 0, so that their sign is the truth (``x < 4`` is false at 4)."""

    def compare(self, node: Comparison, left: Value, right: Value) -> Any:
        """Return the margin, with 0 replaced by the smallest number of the right sign."""
        value = RobustnessAlgebra.compare(self, node, left, right)
        if np.count_nonzero(value) < value.size:
            return np.where(np.equal(value, 0.0), TINY if _TRUE_AT_ZERO[node.op] else -TINY, value)[()]
        return value

    def bound_unseen_samples(self, node: Comparison) -> Range:
        """Return the range, with an end of 0 replaced likewise."""
        nudge = TINY if _TRUE_AT_ZERO[node.op] else -TINY
        low, high = super().bound_unseen_samples(node)
        return low or nudge, high or nudge

    def xor(self, left: Array, right: Array) -> Array:
        """Return the exclusive or: positive where one of the signs is, and no margin."""
        return np.asarray(-np.sign(left) * right)

    def xor_range(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """Return the range of ``xor``, which is that over the four corners."""
        corners = [self.xor(x, y) for x in (a, b) for y in (c, d)]
        return np.minimum.reduce(corners), np.maximum.reduce(corners)


class IntervalAlgebra(RobustnessAlgebra):
    """Robust satisfaction intervals: axis 1 holds the lower and the upper bound over all unseen samples.

    Args:
        exact: Algebra of the bounds.
        endless: True if the trace continues after the last sample, repeating its interval.
    """

    lead = 3

    def __init__(self, exact: RobustnessAlgebra, endless: bool) -> None:
        self.exact, self.endless = exact, endless

    def negate(self, x: Array) -> Array:
        """Return not x: negated and swapped bounds."""
        return np.asarray(np.negative(x[:, ::-1]))

    def xor(self, left: Array, right: Array) -> Array:
        """Return the interval of the exclusive or."""
        ends = left[:, 0], left[:, -1], right[:, 0], right[:, -1]  # known values have one bound
        return np.stack(self.exact.xor_range(*ends), axis=1)

    def ahead(self, x: Array, by: int) -> Array:
        """Return the intervals followed by ``by`` copies of the last one, if the trace is endless."""
        return np.concatenate([x, np.repeat(x[-1:], by, axis=0)]) if self.endless and by and len(x) else x


@functools.lru_cache(maxsize=1024)
def _bound_margin(node: Comparison) -> Range:
    sides = (node.right, node.left) if node.op in ("<", "<=") else (node.left, node.right)
    margin: Term = Arithmetic("-", *sides)
    if node.op in ("==", "!="):
        margin = Call("abs", (margin,))
    return _find_range(Negative(margin) if node.op == "==" else margin)


def _find_range(term: Term) -> Range:
    # Interval arithmetic over all values of the signals; products, quotients and powers count as unbounded.
    match term:
        case Number(value):
            return value, value
        case Negative(operand):
            low, high = _find_range(operand)
            return -high, -low
        case Arithmetic("+", left, right):
            return _find_range(Arithmetic("-", left, Negative(right)))
        case Arithmetic("-", left, right):
            (low, high), (least, most) = _find_range(left), _find_range(right)
            low, high = low - most, high - least
            return -math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high
        case Call("abs", (argument,)):
            low, high = _find_range(argument)
            sizes = abs(low), abs(high)
            return 0.0 if low <= 0.0 <= high else min(sizes), max(sizes)
        case Call("sqrt" | "exp"):
            return 0.0, math.inf
        case Call("min" | "max" as function, arguments):
            choose = min if function == "min" else max
            lows, highs = zip(*map(_find_range, arguments), strict=True)
            return choose(lows), choose(highs)
    return -math.inf, math.inf
