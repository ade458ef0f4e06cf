"""What is legal in a formula's text but often not what its writer means."""

from __future__ import annotations

from typing import Any

from avrare.logic.complaints import Complaint, pointed
from avrare.logic.definitions import Definitions

_SIGNLESS = {
    "iff": "-|l - r|: at most 0, whether it holds or not",
    "xor": "|l - r|: at least 0, whether it holds or not",
    "==": "-|l - r|: 0 where it holds, never above",
    "!=": "|l - r|: 0 where it is broken, never below",
}
_SAME = {"<->": "iff", "!==": "!="}
_TERMS = ("signal", "arithmetic", "negative", "call")
_BINARY = ("connective", "implication", "until")


def find(text: str, definitions: Definitions, trees: list[Any]) -> tuple[Complaint, ...]:
    """The warnings about a text that has been read, in the order of their places.

    Args:
        text: The text.
        definitions: What it defines and uses.
        trees: Its statements (lark trees).
    """
    found = [*_unused(text, definitions), *_named_signal(text, definitions, trees[-1])]
    parts = [part for tree in trees for part in tree.iter_subtrees()]
    for part in parts:
        if part.data in _BINARY:
            found += _early_end(text, part)
    found += _signless(text, parts)
    return tuple(complaint for _, complaint in sorted(found, key=lambda pair: pair[0]))


Placed = tuple[tuple[int, int], Complaint]


def _placed(text: str, place: Any, message: str, hint: str) -> Placed:
    return (place.line, place.column), Complaint(pointed(text, place, message), hint)


def _unused(text: str, definitions: Definitions) -> list[Placed]:
    hint = "delete it, or use it in the last statement"
    return [
        _placed(text, each.name, f"{name} is defined but never used", hint)
        for name, each in definitions.all.items()
        if each is not definitions.last and name not in definitions.used
    ]


def _named_signal(text: str, definitions: Definitions, tree: Any) -> list[Placed]:
    """``p = q`` or ``p = q + 1`` at the end defines p as what stands there, above 0."""
    last = definitions.last
    if last.name is None or last.body.data not in _TERMS or str(last.body.children[0]) in definitions.all:
        return []
    message = f"'=' does not compare: what follows, above 0, is the formula, and {last.name} is its name"
    return [_placed(text, tree.children[1], message, f"write {last.name} == ... to compare")]


def _early_end(text: str, tree: Any) -> list[Placed]:
    """``always p and q``: the operand ends before ``and``; fine where another always follows."""
    op, operand = None, tree.children[0]
    while operand.data in (*_BINARY, "window", "step", "negation"):
        if operand.data in ("window", "step"):
            op = op or operand.children[0]
        elif operand.data in _BINARY:
            op = None
        operand = operand.children[-1]
    if op is None or operand.data == "group" or tree.children[-1].data in ("window", "step"):
        return []
    joint = tree.children[1]
    message = f"{op!s} binds tighter than {joint!s}: its operand ends before {joint!s}"
    hint = f"write ({op} ...) {joint} ... if that is meant, {op} (... {joint} ...) if not"
    return [_placed(text, op, message, hint)]


def _signless(text: str, parts: list[Any]) -> list[Placed]:
    """The first of each operator whose robustness does not tell by its sign whether it holds."""
    first: dict[str, Any] = {}
    for part in parts:
        if part.data in ("connective", "compared"):
            token = part.children[1]
            op = _SAME.get(str(token), str(token))
            if op in _SIGNLESS and (op not in first or token.start_pos < first[op].start_pos):
                first[op] = token
    hint = "verdicts are exact; where robustness matters write it with and, or, not, < and >"
    return [
        _placed(text, token, f"the robustness of {token!s} is {_SIGNLESS[op]}", hint)
        for op, token in first.items()
    ]
