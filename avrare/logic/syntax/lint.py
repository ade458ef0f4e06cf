"""Lint warnings: text that is a legal formula but often not what its author means."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from avrare.logic.syntax.definitions import Definitions, get_subtree, get_token
from avrare.logic.syntax.places import Place, add_place, find_position

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


Finding = tuple[Place, str, str]
"""Place, message and hint."""


def find_lint_warnings(
    text: str, definitions: Definitions, trees: list[Tree[Token]]
) -> tuple[LintWarning, ...]:
    """Return the warnings about a text that has been parsed to ``trees``, sorted by place."""
    parts = [part for tree in trees for part in tree.iter_subtrees()]
    findings = [*_find_unused(definitions), *_find_assigned_signal(definitions, trees[-1])]
    findings += [*_find_early_ends(parts), *_find_signless(parts)]
    warnings = [(finding, False) for finding in findings]
    warnings += [(finding, True) for finding in _find_closed_untils(parts)]
    warnings.sort(key=lambda pair: find_position(pair[0][0]))
    return tuple(
        LintWarning(add_place(text, place, message), hint, of_closed)
        for (place, message, hint), of_closed in warnings
    )


def choose_warnings(warnings: tuple[LintWarning, ...], until: str) -> tuple[LintWarning, ...]:
    """Return the warnings that apply when ``until`` is read as ``closed`` or half-open."""
    return tuple(warning for warning in warnings if until == "closed" or not warning.of_closed)


def _find_unused(definitions: Definitions) -> Iterator[Finding]:
    for definition in definitions.all.values():
        name = definition.name
        if name is not None and definition is not definitions.last and str(name) not in definitions.used:
            yield name, f"{name} is defined but never used", "delete it, or use it in the last statement"


def _find_assigned_signal(definitions: Definitions, tree: Tree[Token]) -> Iterator[Finding]:
    # ``p = q`` or ``p = q + 1`` as the last statement defines p as ``q > 0``.
    last = definitions.last
    is_term = last.body.data in ("signal", "arithmetic", "negative", "call")
    if last.name is not None and is_term and str(last.body.children[0]) not in definitions.all:
        message = f"'=' does not compare: it names the formula {last.name}, which is the right side above 0"
        yield get_token(tree, 1), message, f"write {last.name} == ... to compare"


def _find_early_ends(parts: list[Tree[Token]]) -> Iterator[Finding]:
    # In ``always p and q`` the operand ends before ``and``; that is fine if another always follows.
    for tree in parts:
        if tree.data not in _BINARY or get_subtree(tree, -1).data in ("window", "step"):
            continue
        op, operand = None, get_subtree(tree, 0)
        while operand.data in (*_BINARY, "window", "step", "negation"):
            if operand.data in ("window", "step"):
                op = op or get_token(operand, 0)
            elif operand.data in _BINARY:
                op = None
            operand = get_subtree(operand, -1)
        if op is not None and operand.data != "group":
            joint = get_token(tree, 1)
            hint = f"write ({op} ...) {joint} ... if that is meant, {op} (... {joint} ...) if not"
            yield op, f"{op!s} binds tighter than {joint!s}: its operand ends before {joint!s}", hint


def _find_closed_untils(parts: list[Tree[Token]]) -> Iterator[Finding]:
    # Where both sides are about one signal, the left one seldom holds where the right one does.
    hint = "write (left or right) {0} right; or choose the half-open reading, that of rtamt"
    message = "the left side of {0} must hold where the right one does, too, as they are read here"
    untils = [tree for tree in parts if tree.data == "until" and get_token(tree, 1).type != "UNLESS"]
    for tree in untils:
        if _list_signals(get_subtree(tree, 0)) & _list_signals(get_subtree(tree, -1)):
            op = get_token(tree, 1)
            yield op, message.format(op), hint.format(op)


def _list_signals(tree: Tree[Token]) -> set[str]:
    # A relation counts with its vehicles, which are no signals themselves.
    relations = [part for part in tree.iter_subtrees() if part.data == "relation"]
    inside = {id(part) for relation in relations for part in relation.iter_subtrees()}
    signals = [part for part in tree.iter_subtrees() if part.data == "signal" and id(part) not in inside]
    return {" ".join(map(str, part.scan_values(bool))) for part in (*relations, *signals)}


def _find_signless(parts: list[Tree[Token]]) -> Iterator[Finding]:
    # Only the first use of each operator is reported.
    tokens = [get_token(part, 1) for part in parts if part.data in ("connective", "comparison")]
    names = {"<->": "iff", "!==": "!="}
    first = {
        names.get(str(token), str(token)): token for token in sorted(tokens, key=find_position, reverse=True)
    }
    hint = "verdicts are exact; where robustness matters write it with and, or, not, < and >"
    for op in first.keys() & _SIGNLESS.keys():
        yield first[op], f"the robustness of {first[op]!s} is {_SIGNLESS[op]}", hint
