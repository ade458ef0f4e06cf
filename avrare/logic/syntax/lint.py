"""Lint warnings: text that is a legal formula but often not what its author means."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from avrare.logic.syntax.definitions import Definitions, get_subtree, get_token
from avrare.logic.syntax.syntax_errors import Place, add_place

if TYPE_CHECKING:
    from lark import Token, Tree

_SIGNLESS = {
    "iff": "-|l - r|: at most 0, whether it holds or not",
    "xor": "|l - r|: at least 0, whether it holds or not",
    "==": "-|l - r|: 0 where it holds, never above",
    "!=": "|l - r|: 0 where it is false, never below",
}
_BINARY = ("connective", "implication", "until")


@dataclass(frozen=True)
class LintWarning:
    """Warning about a formula's text.

    Attributes:
        message: Place, text and mark in the layout of an error's message:
            ``line 1, column 3: what is odd``, the source line, and a mark below the place.
        hint: Suggestion, if there is one.
        of_closed: Whether it is of the closed reading of until and since alone.
    """

    message: str
    hint: str | None = None
    of_closed: bool = False


_Placed = tuple[tuple[int, int], LintWarning]


def find_lint_warnings(
    text: str, definitions: Definitions, trees: list[Tree[Token]]
) -> tuple[LintWarning, ...]:
    """Return the warnings about a text that has been parsed to ``trees``, sorted by place."""
    warnings = [*_find_unused(text, definitions), *_assigned_signal(text, definitions, trees[-1])]
    parts = [part for tree in trees for part in tree.iter_subtrees()]
    warnings += [warning for part in parts if part.data in _BINARY for warning in _early_end(text, part)]
    warnings += _signless(text, parts)
    warnings += [warning for part in parts if part.data == "until" for warning in _closed_until(text, part)]
    return tuple(warning for _, warning in sorted(warnings, key=lambda pair: pair[0]))


def choose_warnings(warnings: tuple[LintWarning, ...], until: str) -> tuple[LintWarning, ...]:
    """Return the warnings about a text that hold for a reading of until."""
    return tuple(warning for warning in warnings if until == "closed" or not warning.of_closed)


def _warn(text: str, place: Place, message: str, hint: str) -> _Placed:
    return (place.line or 1, place.column or 1), LintWarning(add_place(text, place, message), hint)


def _find_unused(text: str, definitions: Definitions) -> list[_Placed]:
    hint = "delete it, or use it in the last statement"
    return [
        _warn(text, each.name, f"{name} is defined but never used", hint)
        for name, each in definitions.all.items()
        if each.name is not None and each is not definitions.last and name not in definitions.used
    ]


def _assigned_signal(text: str, definitions: Definitions, tree: Tree[Token]) -> list[_Placed]:
    # ``p = q`` or ``p = q + 1`` as the last statement defines p as ``q > 0``.
    last = definitions.last
    terms = ("signal", "arithmetic", "negative", "call")
    if last.name is None or last.body.data not in terms or str(last.body.children[0]) in definitions.all:
        return []
    message = f"'=' does not compare: it names the formula {last.name}, which is the right side above 0"
    return [_warn(text, get_token(tree, 1), message, f"write {last.name} == ... to compare")]


def _early_end(text: str, tree: Tree[Token]) -> list[_Placed]:
    # In ``always p and q`` the operand ends before ``and``; that is fine if another always follows.
    op, operand = None, get_subtree(tree, 0)
    while operand.data in (*_BINARY, "window", "step", "negation"):
        if operand.data in ("window", "step"):
            op = op or get_token(operand, 0)
        elif operand.data in _BINARY:
            op = None
        operand = get_subtree(operand, -1)
    if op is None or operand.data == "group" or get_subtree(tree, -1).data in ("window", "step"):
        return []
    joint = get_token(tree, 1)
    message = f"{op!s} binds tighter than {joint!s}: its operand ends before {joint!s}"
    hint = f"write ({op} ...) {joint} ... if that is meant, {op} (... {joint} ...) if not"
    return [_warn(text, op, message, hint)]


def _closed_until(text: str, tree: Tree[Token]) -> list[_Placed]:
    # Where both sides are about one signal, the left one seldom holds where the right one does.
    op = get_token(tree, 1)
    if not _list_signals(get_subtree(tree, 0)) & _list_signals(get_subtree(tree, -1)) or op.type == "UNLESS":
        return []
    message = f"the left side of {op!s} must hold where the right one does, too, as they are read here"
    hint = f"write (left or right) {op!s} right; or choose the half-open reading, that of rtamt"
    place, warning = _warn(text, op, message, hint)
    return [(place, replace(warning, of_closed=True))]


def _list_signals(tree: Tree[Token]) -> set[str]:
    # A relation counts with its vehicles, which are no signals themselves.
    relations = [part for part in tree.iter_subtrees() if part.data == "relation"]
    inside = {id(part) for relation in relations for part in relation.iter_subtrees()}
    signals = [part for part in tree.iter_subtrees() if part.data == "signal" and id(part) not in inside]
    return {" ".join(map(str, part.scan_values(bool))) for part in (*relations, *signals)}


def _signless(text: str, parts: list[Tree[Token]]) -> list[_Placed]:
    # Only the first use of each operator is reported.
    first: dict[str, Token] = {}
    for part in parts:
        if part.data in ("connective", "comparison"):
            token = get_token(part, 1)
            op = {"<->": "iff", "!==": "!="}.get(str(token), str(token))
            if op in _SIGNLESS and (op not in first or (token.start_pos or 0) < (first[op].start_pos or 0)):
                first[op] = token
    hint = "verdicts are exact; where robustness matters write it with and, or, not, < and >"
    return [
        _warn(text, token, f"the robustness of {token!s} is {_SIGNLESS[op]}", hint)
        for op, token in first.items()
    ]
