"""Printer: syntax tree to formula text, and to English."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from types import MappingProxyType

from avrare.logic.syntax import nodes
from avrare.logic.syntax.token_classes import PREFIX_LETTERS


def to_text(tree: nodes.Node | nodes.Term, names: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the formula or term as text, with bounds in samples; ``names`` replace those of its vehicles."""
    whole, inner = functools.partial(to_text, names=names), functools.partial(_parenthesize, names=names)
    match tree:
        case nodes.Number(value):
            return repr(value).removesuffix(".0")
        case nodes.Signal(name, arguments):
            vehicles = ", ".join(names.get(word, word) for word in arguments)
            return f"{name.split('(')[0]}({vehicles})" if arguments else name
        case nodes.Negative(operand):
            # Without parentheses a minus before a number would be read as part of the number.
            return f"-({whole(operand)})"
        case nodes.Call(function, arguments):
            return f"{function}({', '.join(map(whole, arguments))})"
        case nodes.Constant(value):
            return "true" if value else "false"
        case nodes.Predicate(term):
            return whole(term)
        case nodes.Not(child):
            return f"not {inner(child)}"
        case nodes.Arithmetic(op, left, right) | nodes.Comparison(op, left, right):
            return f"{inner(left)} {op} {inner(right)}"
        case nodes.Connective(op, left, right):
            return f"{inner(left)} {'->' if op == 'implies' else op} {inner(right)}"
        case nodes.Window(op, lo, hi, child):
            return f"{op}{_format_bounds(lo, hi)} {inner(child)}"
        case nodes.Until(op, lo, hi, left, right):
            return f"{inner(left)} {op}{_format_bounds(lo, hi)} {inner(right)}"
        case nodes.Step(op, child):
            return f"{op} ({whole(child)})"
        case nodes.Quantifier(op, variable, group, child, count=count):
            counted = f" {count}" if op == "at_least" else ""
            return f"{op}{counted} {variable} in {group}: {whole(child)}"
    raise TypeError(f"not part of a formula: {tree!r}")


def _parenthesize(tree: nodes.Node | nodes.Term, names: Mapping[str, str]) -> str:
    if isinstance(tree, nodes.Predicate):
        return _parenthesize(tree.term, names)
    # G - 1 would be refused: G may be the operator.
    letter = isinstance(tree, nodes.Signal) and tree.name in PREFIX_LETTERS
    tight = isinstance(tree, nodes.Number | nodes.Signal | nodes.Call | nodes.Constant) and not letter
    return to_text(tree, names) if tight else f"({to_text(tree, names)})"


def _format_bounds(lo: int, hi: float) -> str:
    if lo == 0 and math.isinf(hi):
        return ""
    return f"[{lo}:{'inf' if math.isinf(hi) else int(hi)} samples]"


_COMPARISONS = {
    "<": "is below",
    "<=": "is at most",
    ">": "is above",
    ">=": "is at least",
    "==": "equals",
    "!=": "differs from",
}
_WINDOWS = {
    "always": ("at all times", "at all times {}"),
    "eventually": ("at some time", "at some time {}"),
    "historically": ("at all times so far", "at all times {} ago"),
    "once": ("at some time so far", "at some time {} ago"),
}
_STEPS = {
    "next": "one step later",
    "s_next": "one step later",
    "prev": "one step before",
    "s_prev": "one step before",
    "rise": "from this step on",
    "fall": "until one step before",
}


def to_words(node: nodes.Node, dt: float) -> str:
    """Return a formula in English, with bounds in seconds; ``dt`` is the duration of a step [s]."""
    text = _describe(node, dt)
    begin = text[0] if _begins_with_term(node) else text[0].upper()  # a name stays as it is written
    return f"{begin}{text[1:]}."


def _begins_with_term(node: nodes.Node) -> bool:
    match node:
        case nodes.Connective("implies"):
            return False
        case nodes.Connective(_, left) | nodes.Until(left=left):
            return _begins_with_term(left)
    return isinstance(node, nodes.Comparison | nodes.Predicate)


def _describe(node: nodes.Node, dt: float) -> str:
    match node:
        case nodes.Comparison(op, left, right):
            return f"{to_text(left)} {_COMPARISONS[op]} {to_text(right)}"
        case nodes.Predicate(nodes.Signal() as signal):
            return f"{to_text(signal)} holds"
        case nodes.Predicate(term):
            return f"{to_text(term)} is above 0"
        case nodes.Not(child):
            return f"it is not so that {_inner(child, dt)}"
        case nodes.Connective("implies", left, right):
            return f"if {_inner(left, dt)}, then {_inner(right, dt)}"
        case nodes.Connective(op, left, right):
            word = {"iff": "exactly if", "xor": "or else"}.get(op, op)
            return f"{_inner(left, dt)} {word} {_inner(right, dt)}"
        case nodes.Window(op, lo, hi, child):
            return f"{_describe_window(op, lo, hi, dt)}, {_describe(child, dt)}"
        case nodes.Until(op, lo, hi, left, right):
            within = "" if lo == 0 and math.isinf(hi) else f" ({_describe_bounds(lo, hi, dt)})"
            word = {"release": "released by", "trigger": "after"}.get(op, op)
            return f"{_inner(left, dt)}, {word}{within} {_inner(right, dt)}"
        case nodes.Step(op, child):
            return f"{_STEPS[op]}, {_describe(child, dt)}"
        case nodes.Quantifier(op, variable, group, child, count=count):
            many = {"forall": "for each", "exists": "for some", "at_least": f"for at least {count}"}[op]
            return f"{many} {variable} of {group}, {_describe(child, dt)}"
    return to_text(node)


def _inner(node: nodes.Node, dt: float) -> str:
    # brackets where a part of a part could be read in two ways
    simple = isinstance(node, nodes.Comparison | nodes.Predicate | nodes.Constant)
    return _describe(node, dt) if simple else f"({_describe(node, dt)})"


def _describe_window(op: str, lo: int, hi: float, dt: float) -> str:
    whole, part = _WINDOWS[op]
    past = op in nodes.PAST
    if lo == 0 and math.isinf(hi):
        return whole
    if lo == hi:
        return f"{lo * dt:.4g} s {'before' if past else 'later'}"
    if past and lo == 0:
        return f"{whole.removesuffix(' so far')} of the last {hi * dt:.4g} s"
    return part.format(_describe_bounds(lo, hi, dt))


def _describe_bounds(lo: int, hi: float, dt: float) -> str:
    if math.isinf(hi):
        return f"{lo * dt:.4g} s or more"
    return f"within {hi * dt:.4g} s" if lo == 0 else f"between {lo * dt:.4g} and {hi * dt:.4g} s"
