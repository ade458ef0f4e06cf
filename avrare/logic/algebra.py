"""What the values of a formula may be: margins, truth values, or intervals of margins.

The evaluator builds everything from minimum, maximum and the few operations here, so one evaluator gives
robustness, exact Boolean truth and robust satisfaction intervals.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.formula import Comparison
from avrare.logic.reach import comparison_range

Array = NDArray[Any]

_TRUTH = {
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "==": np.equal,
    "!=": np.not_equal,
}


def difference(left: Any, right: Any) -> Any:
    """``left - right``, and 0 for equal infinities, which have no margin between them."""
    gap = np.subtract(left, right)
    if not np.isnan(gap).any():
        return gap
    return np.where(np.isnan(gap) & np.equal(left, right), 0.0, gap)[()]


class Robustness:
    """Real margins: positive when true, negative when false (rtamt's reading of ==, iff and xor)."""

    top: Any = math.inf
    bottom: Any = -math.inf

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """The shape of a formula's values without trailing axes."""
        return steps, rows

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The value of a comparison of two terms."""
        if node.op in (">", ">="):
            return difference(left, right)
        if node.op in ("<", "<="):
            return difference(right, left)
        distance = np.abs(difference(left, right))
        return -distance if node.op == "==" else distance

    def negate(self, x: Array) -> Array:
        """Not x."""
        return -x

    def xor(self, left: Array, right: Array) -> Array:
        """Exactly one of the two; its negation is iff."""
        return np.asarray(np.abs(difference(left, right)))

    def ahead(self, x: Array, by: int) -> Array:
        """The values with up to ``by`` samples after the last one, where the trace goes on for ever."""
        return x


class Truth(Robustness):
    """True and false, exactly: ``x < 4`` is false at 4 though its robustness is 0 there."""

    top = True
    bottom = False

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The truth of a comparison of two terms."""
        return _TRUTH[node.op](left, right)

    def negate(self, x: Array) -> Array:
        """Not x."""
        return np.logical_not(x)

    def xor(self, left: Array, right: Array) -> Array:
        """Exactly one of the two."""
        return np.not_equal(left, right)


class Bounds(Robustness):
    """Intervals of margins: axis 1 holds the lower and the upper bound; samples not seen yet may be anything.

    Args:
        steps: Samples on the grid, seen or not.
        endless: Whether the trace goes on after the grid, repeating its last interval.
    """

    def __init__(self, steps: int, endless: bool) -> None:
        self.steps = steps
        self.endless = endless

    def shape(self, steps: int, rows: int) -> tuple[int, ...]:
        """The shape of a formula's intervals without trailing axes."""
        return self.steps, 2, rows

    def atom(self, node: Comparison, left: Any, right: Any) -> Any:
        """The exact value where the samples are known, the comparison's range after them."""
        known = super().atom(node, left, right)
        if not isinstance(known, np.ndarray):
            return known
        bounds = np.empty((self.steps, 2, *known.shape[1:]))
        bounds[: len(known)] = known[:, None]
        bounds[len(known) :, 0], bounds[len(known) :, 1] = comparison_range(node)
        return bounds

    def negate(self, x: Array) -> Array:
        """Not x: the bounds change places."""
        return -x[:, ::-1]

    def xor(self, left: Array, right: Array) -> Array:
        """The least and the greatest distance between two intervals."""
        (a, b), (c, d) = (left[:, 0], left[:, 1]), (right[:, 0], right[:, 1])
        least = np.maximum(0.0, np.maximum(difference(a, d), difference(c, b)))
        most = np.maximum(np.abs(difference(a, d)), np.abs(difference(b, c)))
        return np.stack([least, most], axis=1)

    def ahead(self, x: Array, by: int) -> Array:
        """The intervals with ``by`` copies of the last one after it, if the trace is endless."""
        return np.concatenate([x, np.repeat(x[-1:], by, axis=0)]) if self.endless and by else x
