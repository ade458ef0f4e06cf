"""Formulas for people: few parentheses, long ones over several lines; parses to the same formula."""

from __future__ import annotations

from avrare.logic import formula as f
from avrare.logic.printing import bounds, head, text
from avrare.logic.tokens import PREFIX_LETTERS

_LEVELS = {"xor": 1, "iff": 2, "implies": 3, "or": 4, "and": 5, "since": 6, "unless": 7, "until": 8}
_PREFIX, _COMPARED, _ATOM = 9, 10, 14
_ARITHMETIC = {"+": 11, "-": 11, "*": 12, "/": 12}
_INDENT = "    "


def pretty(node: f.Node, width: int = 88) -> str:
    """The formula with the parentheses that it needs, and those that make temporal operators clear.

    Args:
        node: The formula.
        width: Longest line [characters]; a line that cannot be broken may be longer.
    """
    return _lay(node, width, "")


def _lay(node: f.Node, room: int, indent: str) -> str:
    """The formula in ``room`` characters a line, lines after the first indented."""
    flat = _flat(node)
    if len(flat) <= room:
        return flat
    inner = indent + _INDENT
    match node:
        case f.Connective() | f.Until():
            left, right = _sides(node)
            op = _operator(node)
            first = _fit(node.left, left, room, indent)
            return f"{first}\n{indent}{op} {_fit(node.right, right, room - len(op) - 1, indent)}"
        case f.Quantifier(child=child):
            return f"{head(node)}\n{inner}{_lay(child, room - len(_INDENT), inner)}"
        case f.Window(child=child) | f.Step(child=child) | f.Not(child=child):
            start, enclosed = _prefix(node)
            if enclosed:
                return f"{start}(\n{inner}{_lay(child, room - len(_INDENT), inner)}\n{indent})"
            return start + _lay(child, room - len(start), indent)
    return flat


def _fit(node: f.Node, level: int, room: int, indent: str) -> str:
    """An operand, in parentheses if it binds looser than ``level``."""
    if _level(node) >= level:
        return _lay(node, room, indent)
    flat = f"({_flat(node)})"
    inner = indent + _INDENT
    return flat if len(flat) <= room else f"(\n{inner}{_lay(node, room - len(_INDENT), inner)}\n{indent})"


def _flat(item: f.Node | f.Term) -> str:
    match item:
        case f.Connective() | f.Until():
            left, right = _sides(item)
            return f"{_enclose(item.left, left)} {_operator(item)} {_enclose(item.right, right)}"
        case f.Quantifier(child=child):
            return f"{head(item)} {_flat(child)}"
        case f.Window(child=child) | f.Step(child=child) | f.Not(child=child):
            start, enclosed = _prefix(item)
            return f"{start}({_flat(child)})" if enclosed else start + _flat(child)
        case f.Comparison(op, left_term, right_term):
            return f"{_enclose(left_term, _COMPARED + 1)} {op} {_enclose(right_term, _COMPARED + 1)}"
        case f.Predicate(term):
            return _flat(term)
        case f.Arithmetic(op, left_term, right_term):
            level = _ARITHMETIC[op]
            return f"{_enclose(left_term, level)} {op} {_enclose(right_term, level + 1)}"
        case f.Call(function, arguments):
            return f"{function}({', '.join(map(_flat, arguments))})"
        case f.Negative(operand):
            return f"-({_flat(operand)})"
    return text(item)


def _enclose(item: f.Node | f.Term, level: int) -> str:
    return _flat(item) if _level(item) >= level else f"({_flat(item)})"


def _level(item: f.Node | f.Term) -> int:
    """How tightly the outermost operator binds; names that may be operators count as loose."""
    match item:
        case f.Connective(op=op) | f.Until(op=op):
            return _LEVELS[op]
        case f.Quantifier():
            return 0
        case f.Step(op="rise" | "fall"):
            return _ATOM
        case f.Window() | f.Step() | f.Not():
            return _PREFIX
        case f.Comparison():
            return _COMPARED
        case f.Predicate(term):
            return _level(term)
        case f.Arithmetic(op=op):
            return _ARITHMETIC[op]
        case f.Signal(name) if name in PREFIX_LETTERS:
            return 0
    return _ATOM


def _sides(node: f.Connective | f.Until) -> tuple[int, int]:
    """The levels that the operands need: operators associate to the left, but -> does not chain."""
    level = _LEVELS[node.op]
    return level + (node.op == "implies"), level + 1


def _operator(node: f.Connective | f.Until) -> str:
    if isinstance(node, f.Until):
        return node.op + bounds(node.lo, node.hi)
    return "->" if node.op == "implies" else node.op


def _prefix(node: f.Window | f.Step | f.Not) -> tuple[str, bool]:
    """A prefix operator, and whether its operand stands in parentheses: an atom below ``not`` does not.

    Below a temporal operator nearly everything does, so that no reader has to know how far it reaches.
    """
    if isinstance(node, f.Step) and node.op in ("rise", "fall"):
        return node.op, True
    temporal = isinstance(node.child, f.Window | f.Step)
    if isinstance(node, f.Not):
        return "not ", _level(node.child) < _ATOM and not temporal
    start = node.op + (bounds(node.lo, node.hi) if isinstance(node, f.Window) else "") + " "
    return start, not temporal
