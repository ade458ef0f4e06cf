"""Evaluator of formulas on complete traces, by the definition of nominal robustness (stl-ams, Eq. 14).

Arrays are time-major: (T, N, ...). Windows are clipped to the trace: over an empty window always is true and
eventually is false. Terms are functions of the samples, used by monitors too.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, fold_until, slide
from avrare.logic.syntax import nodes

TermFunction = Callable[[Mapping[str, Array]], Any]

_ARITHMETIC = {"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide}
_FUNCTIONS = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "min": np.minimum,
    "max": np.maximum,
    "pow": np.power,
}


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
        values: Dictionary that collects the value of every sub-formula; may be None.
    """

    samples: Mapping[str, Array]
    steps: int
    rows: int
    algebra: RobustnessAlgebra
    closed: bool
    slots: Sequence[Array] = ()
    values: dict[nodes.Node, Array] | None = field(default=None, compare=False)

    def __call__(self, node: nodes.Node) -> Array:
        """Evaluate ``node`` at every sample: (T, N, ...), a new array."""
        with np.errstate(all="ignore"):
            return self._formula(node)

    def _formula(self, node: nodes.Node) -> Array:
        if self.values is None:
            return self._value(node)
        if node not in self.values:
            self.values[node] = self._value(node)
        return self.values[node]

    def _value(self, node: nodes.Node) -> Array:
        match node:
            case nodes.Comparison(_, left, right):
                terms = (compile_term(term, 2)(self.samples) for term in (left, right))
                value = self.algebra.compare(node, *align(*terms))
                return value if isinstance(value, np.ndarray) else np.full((self.steps, self.rows), value)
            case nodes.Constant(value):
                return np.full((self.steps, self.rows), math.inf if value else -math.inf)
            case nodes.Slot(index):
                return self.slots[index]
            case nodes.Predicate() | nodes.Step() | nodes.Connective(op="implies") | nodes.Until(op="unless"):
                return self._formula(nodes.expand(node))
        operands = [self._formula(child) for child in nodes.children(node)]
        may_overwrite = self.values is None and not self.slots
        return operate(node, operands, self.algebra, self.closed, self.algebra.lead, may_overwrite)


def operate(
    node: nodes.Node,
    operands: Sequence[Array],
    algebra: RobustnessAlgebra,
    closed: bool,
    lead: int,
    may_overwrite: bool = False,
) -> Array:
    """Return the value of an operator from those of its operands, which differ in axes that broadcast.

    Args:
        node: Formula in normal form that is no comparison.
        operands: Values of its direct sub-formulas; time is the first axis below temporal operators.
        algebra: Algebra of the values.
        closed: True if until and since need their left operand at the witness too.
        lead: Number of axes before those of the vehicles.
        may_overwrite: True if the operands are not needed any more.
    """
    match node:
        case nodes.Connective():
            return _connect(node.op, operands[0], operands[1], algebra)
        case nodes.Not():
            return algebra.negate(operands[0])
        case nodes.Quantifier():
            return _quantify(node, operands[0], lead)
        case nodes.Window(op, lo, hi) | nodes.Until(op, lo, hi):
            past, steps, join = op in nodes.PAST, len(operands[0]), get_join(op)
            rows = [x[::-1] if past else algebra.ahead(x, lo) for x in operands]
            if len(rows) == 1:
                value = slide(rows[0], lo, hi, join, may_overwrite)
            else:
                value = fold_until(*broadcast(*rows), lo, hi, closed, join)
            return value[::-1] if past else value[:steps]
    raise TypeError(f"not a formula: {node!r}")


def get_join(op: str) -> np.ufunc:
    """Return the ufunc by which a temporal operator joins its samples."""
    return np.minimum if op in ("always", "historically", "release", "trigger") else np.maximum


def _connect(op: str, left: Array, right: Array, algebra: RobustnessAlgebra) -> Array:
    if left.shape != right.shape:
        left, right = align(left, right)
    if op == "and":
        return np.minimum(left, right)
    if op == "or":
        return np.maximum(left, right)
    differ = algebra.xor(*broadcast(left, right))
    return differ if op == "xor" else algebra.negate(differ)


def _quantify(node: nodes.Quantifier, x: Array, lead: int) -> Array:
    # Order statistic over the last axis; ``x`` has ``lead`` axes, then one per quantifier down to this one if
    # it depends on the variable.
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
    """Refuse values with trailing axes left."""
    if trailing > 0:
        raise FormulaError(
            f"the formula has {trailing} trailing {'axes' if trailing > 1 else 'axis'} left at every sample",
            "put 'forall o in others:' or 'exists o in others:' before the part with array-valued signals; a "
            "signal of one number has the shape (N,), not (N, 1)",
        )


@functools.lru_cache(maxsize=1024)
def compile_term(term: nodes.Term, lead: int) -> TermFunction:
    """Compile a term to a function of the samples, which returns a number if it reads no signal.

    Samples have ``lead`` axes before those of the vehicles: 1 for (N, ...), 2 for (T, N, ...).
    """
    match term:
        case nodes.Number(value):
            return lambda samples: value
        case nodes.Signal(name, axes=axes):
            if axes == tuple(range(len(axes))):
                return lambda samples: samples[name]
            return lambda samples: _lay_out(samples[name], axes, lead)
        case nodes.Negative(operand):
            return _apply(np.negative, [compile_term(operand, lead)])
        case nodes.Arithmetic(op, left, right):
            return _apply(_ARITHMETIC[op], [compile_term(left, lead), compile_term(right, lead)])
        case nodes.Call(function, arguments):
            return _apply(_FUNCTIONS[function], [compile_term(argument, lead) for argument in arguments])
    raise TypeError(f"not a term: {term!r}")


def _apply(function: np.ufunc, operands: list[TermFunction]) -> TermFunction:
    if len(operands) == 1:
        (only,) = operands
        return lambda samples: function(only(samples))
    if len(operands) == 2:
        left, right = operands
        return lambda samples: function(*align(left(samples), right(samples)))
    return functools.reduce(lambda x, y: _apply(function, [x, y]), operands)


def _lay_out(x: Array, axes: tuple[int, ...], lead: int) -> Array:
    # Each trailing axis moves to the depth of its quantifier; the same one twice takes the diagonal.
    while len(axes) != len(set(axes)):
        first, second = next((i, j) for j in range(len(axes)) for i in range(j) if axes[i] == axes[j])
        x = np.diagonal(x, axis1=lead + first, axis2=lead + second)
        axes = (*axes[:first], *axes[first + 1 : second], *axes[second + 1 :], axes[first])
    order = np.argsort(axes)
    x = np.transpose(x, (*range(lead), *(int(i) + lead for i in order)))
    return np.expand_dims(x, [lead + axis for axis in range(max(axes)) if axis not in axes])


def align(left: object, right: object) -> tuple[Any, Any]:
    """Add trailing axes to the operand that has fewer; numbers stay numbers."""
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return left, right
    if left.shape == right.shape:
        return left, right
    ndim = max(left.ndim, right.ndim)
    left, right = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (left, right))
    if any(a != b and 1 not in (a, b) for a, b in zip(left.shape, right.shape, strict=True)):
        raise FormulaError(f"signals with shapes {left.shape} and {right.shape} cannot be combined")
    return left, right


def broadcast(left: Array, right: Array) -> tuple[Array, Array]:
    """Return two operands with all their axes."""
    if left.shape == right.shape:
        return left, right
    left, right = np.broadcast_arrays(*align(left, right))
    return left, right
