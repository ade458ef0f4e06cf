"""Terms as functions of the samples, and the alignment of arrays with different trailing axes."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.semantics.window_operators import Array
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


@functools.lru_cache(maxsize=1024)
def compile_term(term: nodes.Term, lead: int) -> TermFunction:
    """Compile a term to a function of the samples, which returns a number if it reads no signal.

    Args:
        term: Term.
        lead: Axes of a sample before those of the vehicles: 1 for (N, ...), 2 for (T, N, ...).
    """
    match term:
        case nodes.Number(value):
            return lambda samples: value
        case nodes.Signal(name, axes=axes):
            if axes == tuple(range(len(axes))):
                return lambda samples: samples[name]
            return lambda samples: lay_out(samples[name], axes, lead)
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


def lay_out(x: Array, axes: tuple[int, ...], lead: int = 2) -> Array:
    """Move the trailing axes of a relation's samples to the quantifiers that they belong to.

    Args:
        x: ``lead`` axes and then one for each of ``axes``.
        axes: Depth of the quantifier of each trailing axis; the same one twice takes the diagonal.
        lead: Axes before the trailing ones.
    """
    if axes == tuple(range(len(axes))):
        return x
    while len(axes) != len(set(axes)):
        first, second = next(
            (i, j) for j in range(len(axes)) for i in range(j) if axes[i] == axes[j]
        )  # fmt: skip
        x = np.diagonal(x, axis1=lead + first, axis2=lead + second)
        axes = (*axes[:first], *axes[first + 1 : second], *axes[second + 1 :], axes[first])
    order = np.argsort(axes)
    x = np.transpose(x, (*range(lead), *(int(i) + lead for i in order)))
    lengths = [1] * (max(axes) + 1)
    for axis, length in zip(sorted(axes), x.shape[lead:], strict=True):
        lengths[axis] = length
    return x.reshape(*x.shape[:lead], *lengths)


def align(left: Any, right: Any) -> tuple[Any, Any]:
    """Add trailing axes to the operand that has fewer; numbers stay numbers.

    Raises:
        FormulaError: The operands cannot be broadcast.
    """
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return left, right
    if left.shape == right.shape:
        return left, right
    ndim = max(left.ndim, right.ndim)
    left, right = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (left, right))
    if any(a != b and 1 not in (a, b) for a, b in zip(left.shape, right.shape, strict=True)):
        raise FormulaError(f"signals with shapes {left.shape} and {right.shape} cannot be combined")
    return left, right
