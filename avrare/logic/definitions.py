"""The statements of a text: ``name = formula``, ``name(o) = formula``, and the formula at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from avrare.logic.complaints import complain

_NUMERIC = {"number", "negative", "arithmetic", "call", "group"}


@dataclass(frozen=True)
class Definition:
    """A named formula or term.

    Attributes:
        name: Where it is defined (lark token).
        parameters: The vehicles that it takes.
        body: lark tree.
        index: Number of statements before it.
    """

    name: Any
    parameters: tuple[str, ...]
    body: Any
    index: int


class Definitions:
    """What a text defines.

    Attributes:
        all: name -> definition, in order; the last statement's too if it has a name.
        last: The last statement: a definition without parameters, or one without a name.
        used: The names that some statement uses.
    """

    def __init__(self, text: str, statements: list[Any]) -> None:
        """Read the statements (lark trees).

        Raises:
            FormulaError: One without a name is not the last, a name is defined twice, or the last one is no
                formula.
        """
        self.text = text
        self.all: dict[str, Definition] = {}
        self.used: set[str] = set()
        for index, tree in enumerate(statements):
            found = self._read(tree, index)
            if found.name is not None:
                self._add(found)
            elif index + 1 < len(statements):
                hint = "join it to the line before with and, or, ->; or name the formula before: name = ..."
                raise complain(text, statements[index + 1].meta, "a formula ended before this one", hint)
            self.last = found
        self._check_last(statements[-1])

    def visible(self, name: str, place: Any, index: int) -> Definition | None:
        """The definition of ``name`` for statement ``index``; None if it is a signal.

        Raises:
            FormulaError: It is defined at or below that statement.
        """
        found = self.all.get(name)
        if found is None:
            return None
        if found.index == index:
            raise complain(
                self.text, place, f"{name} is defined by itself", "a definition uses earlier ones only"
            )
        if found.index > index:
            where = f"line {found.name.line}"
            raise complain(self.text, place, f"{name} is defined below its use", f"move it up from {where}")
        self.used.add(name)
        return found

    def number(self, token: Any, index: int) -> Any:
        """The number (token) that the name in a bound stands for.

        Raises:
            FormulaError: The name is no constant.
        """
        found = self.visible(str(token), token, index)
        if found is None or found.body.data != "number":
            message = f"{token} is {'not a number of zero or above' if found else 'not defined'}"
            raise complain(self.text, token, message, f"define it above: const float {token} = 3")
        return found.body.children[0]

    def _read(self, tree: Any, index: int) -> Definition:
        if tree.data != "definition":
            return Definition(None, (), tree, index)
        head, _, body = tree.children
        if not hasattr(head, "data"):
            return Definition(head, (), body, index)
        name, _, *parameters = head.children
        return Definition(name, tuple(self._parameter(each) for each in parameters), body, index)

    def _parameter(self, tree: Any) -> str:
        if tree.data != "signal":
            hint = "a parameter is a name that stands for a vehicle: cut_in_begins(o) = ..."
            raise complain(self.text, tree.meta, "this is no name of a parameter", hint)
        return str(tree.children[0])

    def _add(self, found: Definition) -> None:
        name = str(found.name)
        if name in self.all:
            where = f"line {self.all[name].name.line}"
            raise complain(self.text, found.name, f"{name} is defined twice", f"the first time is in {where}")
        if len(set(found.parameters)) < len(found.parameters):
            raise complain(self.text, found.name, f"two parameters of {name} have the same name")
        self.all[name] = found

    def _check_last(self, tree: Any) -> None:
        last = self.last
        if last.parameters:
            hint = f"add the formula that uses it, such as: forall o in others: always {last.name}(o)"
            raise complain(self.text, last.name, f"{last.name} is only defined", hint)
        if last.name is not None and {part.data for part in last.body.iter_subtrees()} <= _NUMERIC:
            hint = "write == to compare; the last statement is the formula"
            raise complain(self.text, tree.children[1], "'=' defines a number, not a formula", hint)
