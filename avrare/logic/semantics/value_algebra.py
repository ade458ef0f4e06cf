"""Value algebras: robustness, signed robustness, truth values, and intervals of these.

Temporal and Boolean operators are minimum and maximum in every algebra, so one evaluator computes robustness,
exact Boolean truth and robust satisfaction intervals.
"""

from __future__ import annotations

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
    """Real margins: positive when true, negative when false (rtamt's reading of ==, iff and xor)."""

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """Return the shape of a formula's values without trailing axes."""
        return steps, rows

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
        return _comparison_range(node)

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
    """Margins that are never 0, so that their sign is the truth (``x < 4`` is false at 4).

    Minimum, maximum and negation preserve signs; iff and xor do not.
    """

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


class TruthAlgebra(SignedAlgebra):
    """Truth values: infinity for true, minus infinity for false."""

    def compare(self, node: Comparison, left: Value, right: Value) -> Any:
        """Return the truth of a comparison of two terms; NaN stays NaN."""
        return np.multiply(super().compare(node, left, right), math.inf)

    def bound_unseen_samples(self, node: Comparison) -> Range:
        """Return false and true, unless the ranges of the terms decide."""
        low, high = super().bound_unseen_samples(node)
        return low * math.inf, high * math.inf

    def xor(self, left: Array, right: Array) -> Array:
        """Return the exclusive or."""
        return np.asarray(-(left * right))

    def xor_range(self, a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
        """Return false and true, unless both sides are known."""
        corners = [self.xor(x, y) for x in (a, b) for y in (c, d)]
        return np.minimum.reduce(corners), np.maximum.reduce(corners)


class IntervalAlgebra(RobustnessAlgebra):
    """Robust satisfaction intervals: axis 1 holds the lower and the upper bound over all unseen samples.

    Args:
        exact: Algebra of the bounds.
        steps: Samples on the grid, seen or not.
        endless: True if the trace continues after the grid, repeating its last interval.
    """

    def __init__(self, exact: RobustnessAlgebra, steps: int, endless: bool) -> None:
        self.exact = exact
        self.steps = steps
        self.endless = endless

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """Return the shape of a formula's intervals without trailing axes."""
        return self.steps, 2, rows

    def compare(self, node: Comparison, left: Value, right: Value) -> Any:
        """Return the exact value at seen samples, the comparison's range after them."""
        exact = self.exact.compare(node, left, right)
        if not isinstance(exact, np.ndarray):
            return exact
        bounds = np.empty((self.steps, 2, *exact.shape[1:]))
        bounds[: len(exact)] = exact[:, None]
        bounds[len(exact) :, 0], bounds[len(exact) :, 1] = self.exact.bound_unseen_samples(node)
        return bounds

    def negate(self, x: Array) -> Array:
        """Return not x: negated and swapped bounds."""
        return np.asarray(np.negative(x[:, ::-1]))

    def xor(self, left: Array, right: Array) -> Array:
        """Return the interval of the exclusive or."""
        ends = left[:, 0], left[:, -1], right[:, 0], right[:, -1]  # known values have one bound
        return np.stack(self.exact.xor_range(*ends), axis=1)

    def ahead(self, x: Array, by: int) -> Array:
        """Return the intervals followed by ``by`` copies of the last one, if the trace is endless."""
        return np.concatenate([x, np.repeat(x[-1:], by, axis=0)]) if self.endless and by else x


def _comparison_range(node: Comparison) -> Range:
    low, high = _subtract_ranges(_term_range(node.left), _term_range(node.right))
    if node.op in (">", ">="):
        return low, high
    if node.op in ("<", "<="):
        return -high, -low
    near, far = _absolute_range((low, high))
    return (-far, -near) if node.op == "==" else (near, far)


def _term_range(term: Term) -> Range:
    # Interval arithmetic over all values of the signals; products, quotients and powers count as unbounded.
    match term:
        case Number(value):
            return value, value
        case Negative(operand):
            low, high = _term_range(operand)
            return -high, -low
        case Arithmetic("+", left, right):
            low, high = _term_range(right)
            return _subtract_ranges(_term_range(left), (-high, -low))
        case Arithmetic("-", left, right):
            return _subtract_ranges(_term_range(left), _term_range(right))
        case Call("abs", (argument,)):
            return _absolute_range(_term_range(argument))
        case Call("sqrt" | "exp"):
            return 0.0, math.inf
        case Call("min" | "max" as function, arguments):
            choose = min if function == "min" else max
            lows, highs = zip(*map(_term_range, arguments), strict=True)
            return choose(lows), choose(highs)
        case _:
            return (-math.inf, math.inf)


def _subtract_ranges(left: Range, right: Range) -> Range:
    low, high = left[0] - right[1], left[1] - right[0]
    return -math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high


def _absolute_range(values: Range) -> Range:
    low, high = values
    near = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    return near, max(abs(low), abs(high))
