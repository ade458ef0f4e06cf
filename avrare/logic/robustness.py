"""Evaluation of a formula on whole traces, by the definitions of nominal robustness.

Arrays are time-major: (T, N, ...). Windows are clipped to the trace (stl-ams eq. 14): over nothing, always is
true and eventually is false.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.windows import shift, sliding, until

Array = NDArray[Any]

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
    """Values of formulas on one batch of traces.

    Attributes:
        samples: name -> (T, N, ...) float samples.
        steps: T.
        rows: N.
        algebra: What values are.
        closed: Whether until and since need their left operand at the witness too.
        slots: Values of the ``Slot`` formulas, (T, N, ...) each.
    """

    samples: Mapping[str, Array]
    steps: int
    rows: int
    algebra: Robustness
    closed: bool
    slots: Sequence[Array] = ()

    def __call__(self, node: f.Node) -> Array:
        """The value of ``node`` at every sample: (T, N, ...).

        Raises:
            FormulaError: The shapes of the signals do not fit the formula.
        """
        with np.errstate(all="ignore"):
            return self._formula(node)

    def last(self, steps: int, window: float) -> Evaluator:
        """The evaluator of the last ``window`` of the first ``steps`` samples."""
        first = int(max(0, steps - window))
        samples = {name: values[first:steps] for name, values in self.samples.items()}
        return replace(self, samples=samples, steps=steps - first)

    def reduction(self, op: str) -> tuple[np.ufunc, Any]:
        """How a window operator joins values, and its value over nothing."""
        if op in ("always", "historically"):
            return np.minimum, self.algebra.top
        return np.maximum, self.algebra.bottom

    def _formula(self, node: f.Node) -> Array:
        match node:
            case f.Comparison():
                return self._comparison(node)
            case f.Predicate(term):
                return self._comparison(f.Comparison(">", term, f.Number(0.0)))
            case f.Constant(value):
                return self._full(self.algebra.top if value else self.algebra.bottom)
            case f.Not(child):
                return self.algebra.negate(self._formula(child))
            case f.Connective(op, left, right):
                return self._connective(op, *align(self._formula(left), self._formula(right)))
            case f.Forall(child):
                return self._quantify(self._formula(child), np.minimum, self.algebra.top)
            case f.Exists(child):
                return self._quantify(self._formula(child), np.maximum, self.algebra.bottom)
            case f.Slot(index):
                return self.slots[index]
            case _:
                return self._temporal(node)

    def _temporal(self, node: f.Node) -> Array:
        match node:
            case f.Window(op, lo, hi, child):
                join, empty = self.reduction(op)
                x = self._formula(child)
                if op in f.PAST:
                    return sliding(x[::-1], lo, hi, join, empty)[::-1]
                return sliding(self._ahead(x, lo, hi), lo, hi, join, empty)[: len(x)]
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
        lo, hi, (top, bottom) = node.lo, node.hi, (self.algebra.top, self.algebra.bottom)
        if node.op == "since":
            return until(left[::-1], right[::-1], lo, hi, self.closed, top, bottom)[::-1]
        steps = len(left)
        left, right = self._ahead(left, lo, hi), self._ahead(right, lo, hi)
        return until(left, right, lo, hi, self.closed, top, bottom)[:steps]

    def _step(self, op: str, x: Array) -> Array:
        negate, top, bottom = self.algebra.negate, self.algebra.top, self.algebra.bottom
        match op:
            case "next" | "s_next":
                fill = top if op == "next" else bottom
                return shift(self._ahead(x, 1, 1), 1, fill)[: len(x)]
            case "prev" | "s_prev":
                return shift(x, -1, top if op == "prev" else bottom)
            case "rise":
                return np.minimum(negate(shift(x, -1, bottom)), x)
            case _:
                return np.minimum(shift(x, -1, top), negate(x))

    def _connective(self, op: str, left: Array, right: Array) -> Array:
        match op:
            case "and":
                return np.minimum(left, right)
            case "or":
                return np.maximum(left, right)
            case "implies":
                return np.maximum(self.algebra.negate(left), right)
            case _:
                left, right = np.broadcast_arrays(left, right)
                differ = self.algebra.xor(left, right)
                return differ if op == "xor" else self.algebra.negate(differ)

    def _quantify(self, x: Array, join: np.ufunc, empty: Any) -> Array:
        if x.ndim == len(self._shape):
            raise FormulaError(
                "a quantifier needs a formula with an axis to reduce: its signals have one value a sample",
                "give the quantified signals as (N, T, V) arrays",
            )
        return np.asarray(join.reduce(x, axis=-1, initial=empty))

    def _comparison(self, node: f.Comparison) -> Array:
        value = self.algebra.atom(node, *align(self._term(node.left), self._term(node.right)))
        return value if isinstance(value, np.ndarray) else self._full(value)

    def _term(self, term: f.Term) -> Any:
        match term:
            case f.Number(value):
                return value
            case f.Signal(name):
                return self.samples[name]
            case f.Negative(operand):
                return np.negative(self._term(operand))
            case f.Arithmetic(op, left, right):
                return _ARITHMETIC[op](*align(self._term(left), self._term(right)))
            case f.Call(function, [argument]):
                return _FUNCTIONS[function](self._term(argument))
            case f.Call(function, arguments):
                values = map(self._term, arguments)
                return functools.reduce(lambda x, y: _FUNCTIONS[function](*align(x, y)), values)
        raise TypeError(f"not a term: {term!r}")

    def _ahead(self, x: Array, lo: int, hi: float) -> Array:
        return self.algebra.ahead(x, lo if math.isinf(hi) else int(hi))

    @property
    def _shape(self) -> tuple[int, ...]:
        return self.algebra.shape(self.steps, self.rows)

    def _full(self, value: Any) -> Array:
        return np.full(self._shape, value)


def align(left: Any, right: Any) -> tuple[Any, Any]:
    """Two operands with trailing axes added to the one that has fewer; numbers stay numbers.

    Raises:
        FormulaError: Their trailing axes have different lengths.
    """
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return left, right
    if left.shape == right.shape:
        return left, right
    ndim = max(left.ndim, right.ndim)
    left, right = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (left, right))
    if any(a != b and 1 not in (a, b) for a, b in zip(left.shape, right.shape, strict=True)):
        raise FormulaError(f"signals with {left.shape[2:]} and {right.shape[2:]} values a sample meet")
    return left, right
