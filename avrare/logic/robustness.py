"""Evaluation of a formula on whole traces, by the definitions of nominal robustness.

Arrays are time-major: (T, N, ...). Windows are clipped to the trace (stl-ams eq. 14): over nothing, always is
true and eventually is false.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.terms import align, reader
from avrare.logic.windows import shift, sliding, until

Array = NDArray[Any]

_DUALS = ("always", "historically", "release", "trigger")


@dataclass(frozen=True)
class Evaluator:
    """Values of formulas on one batch of traces.

    Attributes:
        samples: name -> (T, N, ...) float samples.
        steps: T.
        rows: N.
        algebra: What values are.
        closed: Whether until and since need their left operand at the witness too.
        slots: Values of the ``Slot`` formulas, (T, N, ...) each.
        found: Filled with the value of every sub-formula, outermost first, if it is given.
    """

    samples: Mapping[str, Array]
    steps: int
    rows: int
    algebra: Robustness
    closed: bool
    slots: Sequence[Array] = ()
    found: dict[f.Node, Array] | None = field(default=None, compare=False)

    def __call__(self, node: f.Node) -> Array:
        """The value of ``node`` at every sample: (T, N, ...), a new array.

        Raises:
            FormulaError: The shapes of the signals do not fit the formula.
        """
        with np.errstate(all="ignore"):
            return self._formula(node)

    def _formula(self, node: f.Node) -> Array:
        if self.found is None:
            return self._value(node)
        if node not in self.found:
            self.found[node] = np.empty(0)  # its place, before its parts
            self.found[node] = self._value(node)
        return self.found[node]

    def _value(self, node: f.Node) -> Array:
        match node:
            case f.Comparison():
                return self._comparison(node)
            case f.Predicate(term):
                return self._comparison(f.Comparison(">", term, f.Number(0.0)))
            case f.Constant(value):
                return self._full(math.inf if value else -math.inf)
            case f.Not(child):
                return self.algebra.negate(self._formula(child))
            case f.Connective(op, left, right):
                return connect(op, self._formula(left), self._formula(right), self.algebra)
            case f.Quantifier():
                return quantify(node, self._formula(node.child), len(self._shape))
            case f.Slot(index):
                return self.slots[index]
            case _:
                return self._temporal(node)

    def _temporal(self, node: f.Node) -> Array:
        match node:
            case f.Window(op, lo, hi, child):
                join, x = joining(op), self._formula(child)
                if op in f.PAST:
                    return sliding(x[::-1], lo, hi, join, self._own)[::-1]
                return sliding(self._ahead(x, lo, hi), lo, hi, join, self._own)[: len(x)]
            case f.Until(op="unless"):
                return self._formula(f.expand_unless(node))
            case f.Until():
                return self._until(node)
            case f.Step(op, child):
                return self._step(op, self._formula(child))
        raise TypeError(f"not a formula: {node!r}")

    def _until(self, node: f.Until) -> Array:
        left, right = align(self._formula(node.left), self._formula(node.right))
        left, right = np.broadcast_arrays(left, right)
        lo, hi, join = node.lo, node.hi, joining(node.op)
        if node.op in f.PAST:
            return until(left[::-1], right[::-1], lo, hi, self.closed, join)[::-1]
        steps = len(left)
        left, right = self._ahead(left, lo, hi), self._ahead(right, lo, hi)
        return until(left, right, lo, hi, self.closed, join)[:steps]

    def _step(self, op: str, x: Array) -> Array:
        match op:
            case "next" | "s_next":
                fill = math.inf if op == "next" else -math.inf
                return shift(self._ahead(x, 1, 1), 1, fill)[: len(x)]
            case "prev" | "s_prev":
                return shift(x, -1, math.inf if op == "prev" else -math.inf)
            case "rise":
                return np.asarray(np.minimum(shift(self.algebra.negate(x), -1, math.inf), x))
            case _:
                return np.asarray(np.minimum(shift(x, -1, math.inf), self.algebra.negate(x)))

    def _comparison(self, node: f.Comparison) -> Array:
        left, right = (reader(term, 2)(self.samples) for term in (node.left, node.right))
        value = self.algebra.atom(node, *align(left, right))
        return value if isinstance(value, np.ndarray) else self._full(value)

    def _ahead(self, x: Array, lo: int, hi: float) -> Array:
        return self.algebra.ahead(x, lo if math.isinf(hi) else int(hi))

    @property
    def _own(self) -> bool:
        """Whether a sub-formula's value may be overwritten once the formula above has it."""
        return self.found is None and not self.slots

    @property
    def _shape(self) -> tuple[int, ...]:
        return self.algebra.shape(self.steps, self.rows)

    def _full(self, value: Any) -> Array:
        return np.full(self._shape, value)


def joining(op: str) -> np.ufunc:
    """How a temporal operator joins its witnesses."""
    return np.minimum if op in _DUALS else np.maximum


def connect(op: str, left: Array, right: Array, algebra: Robustness) -> Array:
    """Two operands joined by and, or, implies, iff or xor."""
    if left.shape != right.shape:
        left, right = align(left, right)
    match op:
        case "and":
            return np.minimum(left, right)
        case "or":
            return np.maximum(left, right)
        case "implies":
            return np.asarray(np.maximum(algebra.negate(left), right))
        case _:
            left, right = np.broadcast_arrays(left, right)
            differ = algebra.xor(left, right)
            return differ if op == "xor" else algebra.negate(differ)


def quantify(node: f.Quantifier, x: Array, lead: int) -> Array:
    """The order statistic of a quantifier over the last axis.

    Args:
        node: The quantifier.
        x: Values of its child: ``lead`` axes and then one per quantifier down to this one.
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
    return np.where(last == last, kth, last)  # NaN comes last, and is no member for which it holds


def require_scalar(trailing: int) -> None:
    """Refuse values with ``trailing`` axes left.

    Raises:
        FormulaError: There are any.
    """
    if trailing > 0:
        raise FormulaError(
            f"the formula has {trailing} trailing {'axes' if trailing > 1 else 'axis'} left at every sample",
            "put 'forall o in others:' or 'exists o in others:' before the part with array-valued signals",
        )
