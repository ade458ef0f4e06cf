"""Formulas as text that parses to the same formula, whatever the sampling period."""

from __future__ import annotations

import math

from avrare.logic import formula as f
from avrare.logic.tokens import PREFIX_LETTERS

_TIGHT = (f.Number, f.Signal, f.Call, f.Constant)


def text(item: f.Node | f.Term) -> str:
    """The formula or term as text; bounds are printed in samples."""
    match item:
        case f.Node():
            return _formula(item)
        case f.Number(value):
            return repr(value).removesuffix(".0")
        case f.Signal(name, arguments):
            return f"{name.split('(')[0]}({', '.join(arguments)})" if arguments else name
        case f.Negative(operand):
            # Without parentheses a minus before a number would be read as part of the number.
            return f"-({text(operand)})"
        case f.Arithmetic(op, left, right):
            return f"{_inside(left)} {op} {_inside(right)}"
        case f.Call(function, arguments):
            return f"{function}({', '.join(map(text, arguments))})"
    raise TypeError(f"not part of a formula: {item!r}")


def _formula(node: f.Node) -> str:
    match node:
        case f.Constant(value):
            return "true" if value else "false"
        case f.Predicate(term):
            return text(term)
        case f.Comparison(op, left, right):
            return f"{_inside(left)} {op} {_inside(right)}"
        case f.Not(child):
            return f"not {_inside(child)}"
        case f.Connective(op, left, right):
            return f"{_inside(left)} {'->' if op == 'implies' else op} {_inside(right)}"
        case f.Window(op, lo, hi, child):
            return f"{op}{bounds(lo, hi)} {_inside(child)}"
        case f.Until(op, lo, hi, left, right):
            return f"{_inside(left)} {op}{bounds(lo, hi)} {_inside(right)}"
        case f.Step(op, child):
            return f"{op} ({text(child)})"
        case f.Quantifier(child=child):
            return f"{head(node)} {text(child)}"
    raise TypeError(f"not a formula: {node!r}")


def _inside(item: f.Node | f.Term) -> str:
    if isinstance(item, f.Predicate):
        return _inside(item.term)
    # G - 1 would be refused: G may be the operator.
    letter = isinstance(item, f.Signal) and item.name in PREFIX_LETTERS
    return text(item) if isinstance(item, _TIGHT) and not letter else f"({text(item)})"


def head(node: f.Quantifier) -> str:
    """A quantifier up to its colon."""
    count = f" {node.count}" if node.op == "at_least" else ""
    return f"{node.op}{count} {node.variable} in {node.group}:"


def bounds(lo: int, hi: float) -> str:
    """Bounds in samples; none for ``[0, inf]``."""
    if lo == 0 and math.isinf(hi):
        return ""
    return f"[{lo}:{'inf' if math.isinf(hi) else int(hi)} samples]"
