"""The parts of a formula's value at sample 0 that change as samples arrive.

A leaf turns the newest samples and what it carried along into its value on the prefix; the connectives and
quantifiers above the leaves are then applied to one value each. What is carried are arrays with leading
axis N, so a copied particle carries its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.robustness import Evaluator, align

Array = NDArray[Any]


class Leaf(Protocol):
    """A sub-formula at sample 0.

    Attributes:
        window: How many of the newest samples it reads; ``math.inf``: all.
        horizon: The last sample that can change it.
    """

    @property
    def window(self) -> float: ...  # noqa: D102
    @property
    def horizon(self) -> float: ...  # noqa: D102

    def step(self, evaluate: Evaluator, t: int, carried: Any) -> tuple[Any, Array]:
        """What to carry on, and the value (N, ...) at sample 0 of the samples 0..t.

        Args:
            evaluate: Evaluator whose last sample is ``t`` and which has ``window`` samples, or all.
            t: Index of the newest sample.
            carried: What the step before handed on; None at t = 0.
        """


@dataclass(frozen=True)
class Fold:
    """always or eventually: a running extremum of the child's settled values, joined with the unsettled."""

    op: str
    lo: int
    hi: float
    child: f.Node
    ahead: int
    window: float

    @property
    def horizon(self) -> float:
        """The last sample that can change it."""
        return self.hi + self.ahead

    def step(self, evaluate: Evaluator, t: int, carried: Any) -> tuple[Any, Array]:
        """Fold the position whose value can change no more; carries (folded, newest value of the child)."""
        settled = t - self.ahead
        if carried is not None and settled > self.hi:
            return carried, carried[0]
        values = evaluate(self.child)
        join, empty = evaluate.reduction(self.op)
        folded = np.full_like(values[-1], empty) if carried is None else carried[0]
        if self.lo <= settled:
            folded = join(folded, values[settled - t - 1])
        open_, end = max(self.lo, settled + 1, 0), int(min(self.hi, t)) + 1
        carried = (folded, values[-1].copy())
        if open_ >= end:
            return carried, folded
        first = len(values) - 1 - t
        return carried, join(folded, join.reduce(values[first + open_ : first + end], axis=0))


@dataclass(frozen=True)
class Wait:
    """until with operands that look only back: how well the left has held, and the best witness so far."""

    lo: int
    hi: float
    left: f.Node
    right: f.Node
    window: float

    @property
    def horizon(self) -> float:
        """The last sample that can change it."""
        return self.hi

    def step(self, evaluate: Evaluator, t: int, carried: Any) -> tuple[Any, Array]:
        """Look at one more possible witness."""
        if t > self.hi:
            return carried, carried[1]
        left, right = align(evaluate(self.left)[-1:], evaluate(self.right)[-1:])
        left, right = (x[0] for x in np.broadcast_arrays(left, right))
        if carried is None:
            algebra = evaluate.algebra
            carried = (np.full_like(left, algebra.top), np.full_like(left, algebra.bottom))
        held_before, best = carried
        held = np.minimum(held_before, left)
        if t >= self.lo:
            best = np.maximum(best, np.minimum(right, held if evaluate.closed else held_before))
        return (held, best), best


@dataclass(frozen=True)
class Recompute:
    """Any other formula: evaluated anew on all its samples until its horizon has passed."""

    node: f.Node
    horizon: float

    @property
    def window(self) -> float:
        """All samples up to the horizon."""
        return self.horizon + 1

    def step(self, evaluate: Evaluator, t: int, carried: Any) -> tuple[Any, Array]:
        """Evaluate the prefix."""
        if t <= self.horizon:
            carried = evaluate(self.node)[0].copy()
        return carried, carried
