"""Printer: formulas as text that parses to the same formula at any sampling period."""

from __future__ import annotations

import math

from avrare.logic.syntax import nodes
from avrare.logic.syntax.token_classes import PREFIX_LETTERS

_TIGHT = (nodes.Number, nodes.Signal, nodes.Call, nodes.Constant)


def to_text(tree: nodes.Node | nodes.Term) -> str:
    """Return the formula or term as text, with bounds in samples."""
    match tree:
        case nodes.Number(value):
            return repr(value).removesuffix(".0")
        case nodes.Signal(name, arguments):
            return f"{name.split('(')[0]}({', '.join(arguments)})" if arguments else name
        case nodes.Negative(operand):
            # Without parentheses a minus before a number would be read as part of the number.
            return f"-({to_text(operand)})"
        case nodes.Call(function, arguments):
            return f"{function}({', '.join(map(to_text, arguments))})"
        case nodes.Constant(value):
            return "true" if value else "false"
        case nodes.Predicate(term):
            return to_text(term)
        case nodes.Not(child):
            return f"not {_parenthesize(child)}"
        case nodes.Arithmetic(op, left, right) | nodes.Comparison(op, left, right):
            return f"{_parenthesize(left)} {op} {_parenthesize(right)}"
        case nodes.Connective(op, left, right):
            return f"{_parenthesize(left)} {'->' if op == 'implies' else op} {_parenthesize(right)}"
        case nodes.Window(op, lo, hi, child):
            return f"{op}{_format_bounds(lo, hi)} {_parenthesize(child)}"
        case nodes.Until(op, lo, hi, left, right):
            return f"{_parenthesize(left)} {op}{_format_bounds(lo, hi)} {_parenthesize(right)}"
        case nodes.Step(op, child):
            return f"{op} ({to_text(child)})"
        case nodes.Quantifier(op, variable, group, child, count=count):
            counted = f" {count}" if op == "at_least" else ""
            return f"{op}{counted} {variable} in {group}: {to_text(child)}"
    raise TypeError(f"not part of a formula: {tree!r}")


def _parenthesize(tree: nodes.Node | nodes.Term) -> str:
    if isinstance(tree, nodes.Predicate):
        return _parenthesize(tree.term)
    # G - 1 would be refused: G may be the operator.
    letter = isinstance(tree, nodes.Signal) and tree.name in PREFIX_LETTERS
    return to_text(tree) if isinstance(tree, _TIGHT) and not letter else f"({to_text(tree)})"


def _format_bounds(lo: int, hi: float) -> str:
    if lo == 0 and math.isinf(hi):
        return ""
    return f"[{lo}:{'inf' if math.isinf(hi) else int(hi)} samples]"
