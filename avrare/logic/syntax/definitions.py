"""Definitions of a text, ``name = formula`` or ``name(o) = formula``, and the scope of vehicle names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from avrare.logic.syntax.places import PlacedError
from avrare.logic.syntax.syntax_errors import suggest

if TYPE_CHECKING:
    from lark import Token, Tree


def get_token(tree: Tree[Token], index: int) -> Token:
    """Return a child that is a token."""
    child = tree.children[index]
    assert isinstance(child, str)
    return child


def get_subtree(tree: Tree[Token], index: int) -> Tree[Token]:
    """Return a child that is a tree."""
    child = tree.children[index]
    assert not isinstance(child, str)
    return child


@dataclass(frozen=True)
class Definition:
    """Named formula or term.

    Attributes:
        name: Lark token at its definition; None for an unnamed last statement.
        parameters: Names of the vehicles that it takes.
        body: Lark tree.
        index: Number of statements before it.
    """

    name: Token | None
    parameters: tuple[str, ...]
    body: Tree[Token]
    index: int


class Definitions:
    """Definitions of a text.

    Attributes:
        all: name -> definition, in order; includes the last statement if it has a name.
        last: Last statement: a definition without parameters, or one without a name.
        used: Names that some statement uses.
    """

    def __init__(self, statements: list[Tree[Token]]) -> None:
        self.all: dict[str, Definition] = {}
        self.used: set[str] = set()
        for index, tree in enumerate(statements):
            self.last = _read(tree, index)
            if self.last.name is not None:
                self._add(self.last, self.last.name)
            elif index + 1 < len(statements):
                hint = "join it to the line before with and, or, ->; or name the formula before: name = ..."
                raise PlacedError(statements[index + 1].meta, "a formula ended before this one", hint)
        self._check_last(statements[-1])

    def look_up(self, name: Token, index: int) -> Definition | None:
        """Return the definition of ``name`` for statement ``index``; None if it is a signal."""
        definition = self.all.get(str(name))
        if definition is None:
            return None
        if definition.index == index:
            raise PlacedError(name, f"{name} uses itself", "a definition can only use earlier ones")
        if definition.index > index:
            line = definition.name.line if definition.name is not None else None
            raise PlacedError(name, f"{name} is defined below its use", f"move it up from line {line}")
        self.used.add(str(name))
        return definition

    def _add(self, definition: Definition, name: Token) -> None:
        other = self.all.setdefault(str(name), definition)
        if other is not definition and other.name is not None:
            raise PlacedError(
                name, f"{name} is defined twice", f"it is first defined in line {other.name.line}"
            )
        if len(set(definition.parameters)) < len(definition.parameters):
            raise PlacedError(name, f"two parameters of {name} have the same name")

    def _check_last(self, tree: Tree[Token]) -> None:
        name, body = self.last.name, self.last.body
        if name is not None and self.last.parameters:
            hint = f"add the formula that uses it, such as: forall o in others: always {name}(o)"
            raise PlacedError(name, f"{name} is defined, but a formula is missing", hint)
        numeric = {"number", "negative", "arithmetic", "call", "group"}
        if name is not None and {part.data for part in body.iter_subtrees()} <= numeric:
            hint = "write == to compare; the last statement is the formula"
            raise PlacedError(get_token(tree, 1), "'=' defines a number, not a formula", hint)


def _read(tree: Tree[Token], index: int) -> Definition:
    if tree.data != "definition":
        return Definition(None, (), tree, index)
    head, body = tree.children[0], get_subtree(tree, -1)
    if isinstance(head, str):
        return Definition(head, (), body, index)
    parameters = [get_subtree(head, place) for place in range(2, len(head.children))]
    for parameter in parameters:
        if parameter.data != "signal":
            hint = "a parameter is a name that stands for a vehicle: cut_in_begins(o) = ..."
            raise PlacedError(parameter.meta, "a parameter must be a name", hint)
    names = tuple(str(parameter.children[0]) for parameter in parameters)
    return Definition(get_token(head, 0), names, body, index)


@dataclass(frozen=True)
class Scope:
    """Names visible at a place in a formula.

    Attributes:
        statement: Index of the statement that contains the place; it may use the ones before it.
        names: Quantified variables and parameters of that statement -> the vehicles they stand for.
        bound: Quantified vehicles -> (depth, group), including those of the statements that use this one.
    """

    statement: int
    names: Mapping[str, str] = field(default_factory=dict)
    bound: Mapping[str, tuple[int, str]] = field(default_factory=dict)

    def quantify(self, variable: str, group: str, words: set[str]) -> tuple[str, Scope]:
        """Return the name of a new quantified vehicle, and the scope of the quantifier's body.

        If the formula around it already uses the name for something else, the vehicle gets a new name that
        is not in ``words``.
        """
        vehicle = variable
        if variable in {*self.bound, *self.names.values()}:
            used = words | set(self.bound)
            vehicle = next(new for k in range(2, len(used) + 3) if (new := f"{variable}_{k}") not in used)
        bound = {**self.bound, vehicle: (len(self.bound), group)}
        return vehicle, replace(self, names={**self.names, variable: vehicle}, bound=bound)

    def enter(self, statement: int, parameters: tuple[str, ...], vehicles: tuple[str, ...]) -> Scope:
        """Return the scope of a definition's body."""
        return Scope(statement, dict(zip(parameters, vehicles, strict=True)), self.bound)

    def resolve_vehicle(self, word: Token) -> str:
        """Return the vehicle that the argument ``word`` (a token) refers to."""
        name = str(word)
        if name in self.names:
            return self.names[name]
        self.refuse_capture(word)
        groups = {"others", *(group for _, group in self.bound.values())}
        if name in groups:
            hint = f"write: forall o in {name}: ... with o as the argument"
            raise PlacedError(word, f"{name} is a group, not a vehicle", hint)
        variables = {*self.names, *self.bound} - {"ego"}
        close = suggest(name, variables, 0.75) if name != "ego" else None
        if close:
            hint = f"did you mean {close!r}? if not, give the quantified variable another name"
            raise PlacedError(word, f"{name} is not bound by a quantifier", hint)
        return name

    def refuse_capture(self, word: Token) -> None:
        """Refuse a name that is bound by a quantifier outside the definition."""
        if str(word) in self.bound and str(word) not in self.names:
            message = f"this definition cannot see {word}, which is bound by a quantifier around its use"
            hint = f"make {word} a parameter of the definition, as in: name({word}) = ..."
            raise PlacedError(word, message, hint)
