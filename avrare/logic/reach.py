"""The values that a term or a comparison can take when nothing is known of its signals."""

from __future__ import annotations

import math

from avrare.logic.formula import Arithmetic, Call, Comparison, Negative, Number, Term

Range = tuple[float, float]
ANYTHING: Range = (-math.inf, math.inf)


def comparison_range(node: Comparison) -> Range:
    """Lower and upper bound of the robustness of a comparison over all values of its signals."""
    low, high = _subtract(term_range(node.left), term_range(node.right))
    if node.op in (">", ">="):
        return low, high
    if node.op in ("<", "<="):
        return -high, -low
    near, far = _absolute((low, high))
    return (-far, -near) if node.op == "==" else (near, far)


def term_range(term: Term) -> Range:
    """Lower and upper bound of a term by interval arithmetic; every signal may be anything.

    Products, quotients and powers of signals are not bounded.
    """
    match term:
        case Number(value):
            return value, value
        case Negative(operand):
            low, high = term_range(operand)
            return -high, -low
        case Arithmetic("+", left, right):
            low, high = term_range(right)
            return _subtract(term_range(left), (-high, -low))
        case Arithmetic("-", left, right):
            return _subtract(term_range(left), term_range(right))
        case Call(function, arguments):
            return _call(function, [term_range(argument) for argument in arguments])
        case _:
            return ANYTHING


def _call(function: str, ranges: list[Range]) -> Range:
    match function:
        case "abs":
            return _absolute(ranges[0])
        case "sqrt" | "exp":
            return 0.0, math.inf
        case "min":
            return min(low for low, _ in ranges), min(high for _, high in ranges)
        case "max":
            return max(low for low, _ in ranges), max(high for _, high in ranges)
        case _:
            return ANYTHING


def _subtract(left: Range, right: Range) -> Range:
    low, high = left[0] - right[1], left[1] - right[0]
    return -math.inf if math.isnan(low) else low, math.inf if math.isnan(high) else high


def _absolute(values: Range) -> Range:
    low, high = values
    near = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    return near, max(abs(low), abs(high))
