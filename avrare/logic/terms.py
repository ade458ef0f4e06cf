"""Terms as functions of the samples, and how arrays with different trailing axes meet."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic import formula as f

Array = NDArray[Any]
Reader = Callable[[Mapping[str, Array]], Any]

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
def reader(term: f.Term, lead: int) -> Reader:
    """The term as a function of the samples; its value is an array, or a number where no signal is read.

    Args:
        term: The term.
        lead: Axes of a sample before those of the vehicles: 1 for (N, ...), 2 for (T, N, ...).
    """
    match term:
        case f.Number(value):
            return lambda samples: value
        case f.Signal(name, axes=axes):
            if axes == tuple(range(len(axes))):
                return lambda samples: samples[name]
            return lambda samples: lay_out(samples[name], axes, lead)
        case f.Negative(operand):
            return _apply(np.negative, [reader(operand, lead)])
        case f.Arithmetic(op, left, right):
            return _apply(_ARITHMETIC[op], [reader(left, lead), reader(right, lead)])
        case f.Call(function, arguments):
            return _apply(_FUNCTIONS[function], [reader(argument, lead) for argument in arguments])
    raise TypeError(f"not a term: {term!r}")


def _apply(function: np.ufunc, operands: list[Reader]) -> Reader:
    if len(operands) == 1:
        (only,) = operands
        return lambda samples: function(only(samples))
    if len(operands) == 2:
        left, right = operands
        return lambda samples: function(*align(left(samples), right(samples)))
    return functools.reduce(lambda x, y: _apply(function, [x, y]), operands)


def lay_out(x: Array, axes: tuple[int, ...], lead: int = 2) -> Array:
    """A relation's samples, their trailing axes moved to the quantifiers that they belong to.

    Args:
        x: ``lead`` axes and then one for each of ``axes``.
        axes: The quantifier of each trailing axis, counted from the outermost; the same one twice takes the
            diagonal.
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
    """Two operands with trailing axes added to the one that has fewer; numbers stay numbers.

    Raises:
        FormulaError: Their axes have different lengths.
    """
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return left, right
    if left.shape == right.shape:
        return left, right
    ndim = max(left.ndim, right.ndim)
    left, right = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (left, right))
    if any(a != b and 1 not in (a, b) for a, b in zip(left.shape, right.shape, strict=True)):
        raise FormulaError(f"signals with shapes {left.shape} and {right.shape} meet")
    return left, right
