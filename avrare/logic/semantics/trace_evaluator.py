"""Evaluator of formulas on complete traces, by the definition of nominal robustness (stl-ams, Eq. 14).

Arrays are time-major: (T, N, ...). Windows are clipped to the trace: over an empty window always is true and
eventually is false.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.semantics.terms import align, compile_term
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, fold_until, slide
from avrare.logic.syntax import nodes

_DUALS = ("always", "historically", "release", "trigger")


@dataclass(frozen=True)
class Evaluator:
    """Evaluator of formulas on one batch of traces.

    Attributes:
        samples: name -> (T, N, ...) float samples.
        steps: T.
        rows: N.
        algebra: Algebra of the values.
        closed: True if until and since need their left operand at the witness too.
        slots: Values of the ``Slot`` formulas, (T, N, ...) each.
        found: Dictionary that collects the value of every sub-formula; may be None.
    """

    samples: Mapping[str, Array]
    steps: int
    rows: int
    algebra: RobustnessAlgebra
    closed: bool
    slots: Sequence[Array] = ()
    found: dict[nodes.Node, Array] | None = field(default=None, compare=False)

    def __call__(self, node: nodes.Node) -> Array:
        """Evaluate ``node`` at every sample: (T, N, ...), a new array.

        Raises:
            FormulaError: The shapes of the signals do not fit the formula.
        """
        with np.errstate(all="ignore"):
            return self._formula(node)

    def _formula(self, node: nodes.Node) -> Array:
        if self.found is None:
            return self._value(node)
        if node not in self.found:
            self.found[node] = self._value(node)
        return self.found[node]

    def _value(self, node: nodes.Node) -> Array:
        match node:
            case nodes.Comparison():
                return self._comparison(node)
            case nodes.Predicate() | nodes.Step():
                return self._formula(nodes.expand(node))
            case nodes.Connective(op="implies") | nodes.Until(op="unless"):
                return self._formula(nodes.expand(node))
            case nodes.Constant(value):
                return self._full(math.inf if value else -math.inf)
            case nodes.Not(child):
                return self.algebra.negate(self._formula(child))
            case nodes.Connective(op, left, right):
                return connect(op, self._formula(left), self._formula(right), self.algebra)
            case nodes.Quantifier():
                return quantify(node, self._formula(node.child), len(self._shape))
            case nodes.Slot(index):
                return self.slots[index]
            case nodes.Window():
                return self._window(node)
            case nodes.Until():
                return self._until(node)
        raise TypeError(f"not a formula: {node!r}")

    def _window(self, node: nodes.Window) -> Array:
        x, lo, hi, join = self._formula(node.child), node.lo, node.hi, get_join(node.op)
        may_overwrite = self.found is None and not self.slots
        if node.op in nodes.PAST:
            return slide(x[::-1], lo, hi, join, may_overwrite)[::-1]
        return slide(self._ahead(x, lo, hi), lo, hi, join, may_overwrite)[: len(x)]

    def _until(self, node: nodes.Until) -> Array:
        left, right = align(self._formula(node.left), self._formula(node.right))
        left, right = np.broadcast_arrays(left, right)
        lo, hi, join = node.lo, node.hi, get_join(node.op)
        if node.op in nodes.PAST:
            return fold_until(left[::-1], right[::-1], lo, hi, self.closed, join)[::-1]
        steps = len(left)
        left, right = self._ahead(left, lo, hi), self._ahead(right, lo, hi)
        return fold_until(left, right, lo, hi, self.closed, join)[:steps]

    def _comparison(self, node: nodes.Comparison) -> Array:
        left, right = (compile_term(term, 2)(self.samples) for term in (node.left, node.right))
        value = self.algebra.compare(node, *align(left, right))
        return value if isinstance(value, np.ndarray) else self._full(value)

    def _ahead(self, x: Array, lo: int, hi: float) -> Array:
        return self.algebra.ahead(x, lo if math.isinf(hi) else int(hi))

    @property
    def _shape(self) -> tuple[int, ...]:
        return self.algebra.shape(self.steps, self.rows)

    def _full(self, value: Any) -> Array:
        return np.full(self._shape, value)


def get_join(op: str) -> np.ufunc:
    """Return the ufunc by which a temporal operator joins its samples."""
    return np.minimum if op in _DUALS else np.maximum


def connect(op: str, left: Array, right: Array, algebra: RobustnessAlgebra) -> Array:
    """Join two operands by and, or, iff or xor."""
    if left.shape != right.shape:
        left, right = align(left, right)
    match op:
        case "and":
            return np.minimum(left, right)
        case "or":
            return np.maximum(left, right)
        case _:
            left, right = np.broadcast_arrays(left, right)
            differ = algebra.xor(left, right)
            return differ if op == "xor" else algebra.negate(differ)


def quantify(node: nodes.Quantifier, x: Array, lead: int) -> Array:
    """Reduce the last axis to the quantifier's order statistic.

    Args:
        node: Quantifier.
        x: Values of its child: ``lead`` axes, then one per quantifier down to this one.
        lead: Axes before those of vehicles.

    Raises:
        FormulaError: The values do not depend on the quantifier's variable.
    """
    if x.ndim != lead + node.depth + 1:
        raise FormulaError(
            f"nothing below '{node.op} {node.variable} in {node.group}' depends on {node.variable}",
            f"use {node.variable} as an argument, or give plain signals below it as (N, T, V) arrays",
        )
    if node.op == "forall":
        return np.asarray(np.minimum.reduce(x, axis=-1, initial=math.inf))
    if node.op == "exists":
        return np.asarray(np.maximum.reduce(x, axis=-1, initial=-math.inf))
    if x.shape[-1] < node.count:
        return np.full(x.shape[:-1], -math.inf)
    ordered = np.sort(x, axis=-1)
    kth, last = ordered[..., x.shape[-1] - node.count], ordered[..., -1]
    return np.where(last == last, kth, last)  # NaN is sorted last, but counts for no member


def require_scalar(trailing: int) -> None:
    """Refuse values with trailing axes left.

    Raises:
        FormulaError: ``trailing`` is above 0.
    """
    if trailing > 0:
        raise FormulaError(
            f"the formula has {trailing} trailing {'axes' if trailing > 1 else 'axis'} left at every sample",
            "put 'forall o in others:' or 'exists o in others:' before the part with array-valued signals",
        )
