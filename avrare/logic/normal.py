"""Formulas brought to few operators: what monitors work on.

Negations go down to the comparisons; steps, implications and unless become windows and connectives; offsets
of unbounded operators become windows of one sample: ``once[a,inf] φ`` = ``once[a,a] (once φ)``. What is left
are comparisons, constants, and, or, iff, xor, quantifiers, always, eventually, historically, once, until,
since, and the duals of the last two, release and trigger. Not is left only above at_least.
"""

from __future__ import annotations

import dataclasses
import math

from avrare.logic import formula as f

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
_STEPS = {"next": "always", "s_next": "eventually", "prev": "historically", "s_prev": "once"}
_WAITING = {
    "until": ("and", "always", "eventually"),
    "release": ("or", "eventually", "always"),
    "since": ("and", "historically", "once"),
    "trigger": ("or", "once", "historically"),
}


def core(node: f.Node, positive: bool = True) -> f.Node:
    """The formula, or its negation, in few operators; its robustness and its truth are the same."""
    match node:
        case f.Constant(value):
            return f.Constant(value == positive)
        case f.Predicate(term):
            return core(f.Comparison(">", term, f.Number(0.0)), positive)
        case f.Comparison(op):
            return node if positive else dataclasses.replace(node, op=_OPPOSITE[op])
        case f.Not(child):
            return core(child, not positive)
        case f.Connective("implies", left, right):
            return f.Connective(_signed("or", positive), core(left, not positive), core(right, positive))
        case f.Connective("iff" | "xor" as op, left, right):
            return f.Connective(_signed(op, positive), core(left), core(right))
        case f.Connective(op, left, right):
            return f.Connective(_signed(op, positive), core(left, positive), core(right, positive))
        case f.Quantifier(op="at_least"):
            counted = dataclasses.replace(node, child=core(node.child))
            return counted if positive else f.Not(counted)
        case f.Quantifier(op):
            return dataclasses.replace(node, op=_signed(op, positive), child=core(node.child, positive))
        case _:
            return _temporal(node, positive)


def _signed(op: str, positive: bool) -> str:
    return op if positive else _DUAL[op]


def _temporal(node: f.Node, positive: bool) -> f.Node:
    match node:
        case f.Window(op, lo, hi, child):
            op, child = _signed(op, positive), core(child, positive)
            if math.isinf(hi) and lo > 0:
                return f.Window(op, lo, lo, f.Window(op, 0, hi, child))
            return f.Window(op, lo, hi, child)
        case f.Until(op="unless"):
            return core(f.expand_unless(node), positive)
        case f.Until(op, lo, hi, left, right):
            left, right = core(left, positive), core(right, positive)
            return _until(_signed(op, positive), lo, hi, left, right)
        case f.Step("rise", child):
            return core(f.Connective("and", f.Step("prev", f.Not(child)), child), positive)
        case f.Step("fall", child):
            return core(f.Connective("and", f.Step("prev", child), f.Not(child)), positive)
        case f.Step(op, child):
            return core(f.Window(_STEPS[op], 1, 1, child), positive)
    raise TypeError(f"not a formula: {node!r}")


def _until(op: str, lo: int, hi: float, left: f.Node, right: f.Node) -> f.Node:
    if math.isfinite(hi) or lo == 0:
        return f.Until(op, lo, hi, left, right)
    both, kept, found = _WAITING[op]
    reached = f.Window(found, lo, lo, f.Until(op, 0, hi, left, right))
    return f.Connective(both, f.Window(kept, 0, lo - 1, left), reached)


def truth_at_zero(root: f.Node) -> bool | None:
    """Whether a core formula is true where its robustness is 0; None where it depends.

    Minimum and maximum cannot tell a 0 that is true from one that is false, but where all comparisons are
    strict, or none is, only one of the two is among them.
    """
    parts = list(f.walk(root))
    if any(isinstance(x, f.Not) or (isinstance(x, f.Connective) and x.op in ("iff", "xor")) for x in parts):
        return None
    at_zero = {part.op in ("<=", ">=", "==") for part in parts if isinstance(part, f.Comparison)}
    return at_zero.pop() if len(at_zero) == 1 else None


def is_endless(node: f.Node | f.Term) -> bool:
    """Whether the formula is itself an unbounded future operator."""
    return isinstance(node, f.Window | f.Until) and node.op in f.FUTURE and math.isinf(node.hi)


def obligations(node: f.Node) -> list[f.Node]:
    """The distinct unbounded future operators in a formula, innermost first."""
    found = [part for part in f.walk(node) if isinstance(part, f.Node) and is_endless(part)]
    return list(dict.fromkeys(reversed(found)))


def place_quantifiers(node: f.Node) -> f.Node:
    """A core formula with its outer quantifiers where a monitor wants them, its equal.

    ``forall (always φ)`` becomes ``always (forall φ)``, of which one number per particle is kept, unless φ
    has an unbounded future operator, of which one number per vehicle is needed: then the other way round. The
    same goes for exists and eventually.
    """
    match node:
        case f.Quantifier(op="forall" | "exists" as op):
            child = place_quantifiers(node.child)
            if isinstance(child, f.Window) and _agree(op, child.op) and not obligations(child.child):
                return dataclasses.replace(child, child=dataclasses.replace(node, child=child.child))
            return dataclasses.replace(node, child=child)
        case f.Window(op, child=f.Quantifier() as inner) if _agree(inner.op, op) and obligations(inner):
            inside = place_quantifiers(dataclasses.replace(node, child=inner.child))
            return dataclasses.replace(inner, child=inside)
        case f.Not() | f.Connective():
            return f.rebuild(node, place_quantifiers)
        case _:
            return node


def _agree(quantifier: str, window: str) -> bool:
    return (quantifier, window) in (("forall", "always"), ("exists", "eventually"))
