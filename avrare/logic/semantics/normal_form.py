"""Normal form: a formula in few operators, the input of evaluation and monitors.

Negations are pushed down to the comparisons; steps, implications and unless become windows and connectives;
offsets of unbounded operators become windows of one sample: ``once[a,inf] φ`` = ``once[a,a] (once φ)``. The
result has comparisons, constants, and, or, iff, xor, quantifiers, always, eventually, historically, once,
until, since, and the duals of the last two, release and trigger. Not remains only above at_least.
"""

from __future__ import annotations

import dataclasses
import math

from avrare.logic.syntax import nodes
from avrare.logic.syntax.nodes import Comparison, Connective, Constant, Node, Not, Quantifier, Until, Window

_OPPOSITE = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
_DUAL = {
    "and": "or",
    "iff": "xor",
    "forall": "exists",
    "always": "eventually",
    "historically": "once",
    "until": "release",
    "since": "trigger",
}
_DUAL |= {dual: op for op, dual in _DUAL.items()}
_OFFSET_UNTIL = {
    "until": ("and", "always", "eventually"),
    "release": ("or", "eventually", "always"),
    "since": ("and", "historically", "once"),
    "trigger": ("or", "once", "historically"),
}


def normalise(node: Node, positive: bool = True) -> Node:
    """Return the formula, or its negation, in normal form; robustness and truth are the same."""
    match node:
        case Constant(value):
            return Constant(value == positive)
        case nodes.Predicate() | nodes.Step() | Connective(op="implies") | Until(op="unless"):
            return normalise(nodes.expand(node), positive)
        case Comparison(op):
            return node if positive else dataclasses.replace(node, op=_OPPOSITE[op])
        case Not(child):
            return normalise(child, not positive)
        case Connective("iff" | "xor" as op, left, right):
            return Connective(_sign(op, positive), normalise(left), normalise(right))
        case Connective(op, left, right):
            return Connective(_sign(op, positive), normalise(left, positive), normalise(right, positive))
        case Quantifier(op="at_least"):
            counted = dataclasses.replace(node, child=normalise(node.child))
            return counted if positive else Not(counted)
        case Quantifier(op):
            return dataclasses.replace(node, op=_sign(op, positive), child=normalise(node.child, positive))
        case Window(op, lo, hi, child):
            op, child = _sign(op, positive), normalise(child, positive)
            if math.isinf(hi) and lo > 0:
                return Window(op, lo, lo, Window(op, 0, hi, child))
            return Window(op, lo, hi, child)
        case Until(op, lo, hi, left, right):
            left, right = normalise(left, positive), normalise(right, positive)
            return _until(_sign(op, positive), lo, hi, left, right)
    raise TypeError(f"not a formula: {node!r}")


def _sign(op: str, positive: bool) -> str:
    return op if positive else _DUAL[op]


def _until(op: str, lo: int, hi: float, left: Node, right: Node) -> Node:
    if math.isfinite(hi) or lo == 0:
        return Until(op, lo, hi, left, right)
    both, hold, reach = _OFFSET_UNTIL[op]
    later = Window(reach, lo, lo, Until(op, 0, hi, left, right))
    return Connective(both, Window(hold, 0, lo - 1, left), later)


def find_truth_at_zero(root: Node) -> bool | None:
    """Return whether a normalised formula is true where its robustness is 0; None if that varies.

    Minimum and maximum cannot tell a 0 that is true from one that is false, but if all comparisons are
    strict, or none is, only one of the two occurs.
    """
    parts = list(nodes.walk(root))
    if any(isinstance(x, Not) or nodes.is_signless(x) for x in parts):
        return None
    at_zero = {part.op in ("<=", ">=", "==") for part in parts if isinstance(part, Comparison)}
    return at_zero.pop() if len(at_zero) == 1 else None


def place_quantifiers(node: Node) -> Node:
    """Move the outer quantifiers of a normalised formula to where a monitor needs least memory.

    ``forall (always φ)`` becomes ``always (forall φ)``, which carries one number per particle. If φ has an
    unbounded future operator, which carries one number per vehicle, it is the other way round. Exists and
    eventually are treated alike.
    """
    match node:
        case Quantifier(op="forall" | "exists" as op):
            child = place_quantifiers(node.child)
            if isinstance(child, Window) and _agree(op, child.op) and nodes.horizon(child.child) < math.inf:
                return dataclasses.replace(child, child=dataclasses.replace(node, child=child.child))
            return dataclasses.replace(node, child=child)
        case Window(op, child=Quantifier() as inner) if _agree(inner.op, op) and math.isinf(
            nodes.horizon(inner)
        ):
            inside = place_quantifiers(dataclasses.replace(node, child=inner.child))
            return dataclasses.replace(inner, child=inside)
        case Not() | Connective():
            return nodes.rebuild(node, place_quantifiers)
        case _:
            return node


def _agree(quantifier: str, window: str) -> bool:
    return (quantifier, window) in (("forall", "always"), ("exists", "eventually"))
