"""Which vehicle a name stands for: quantified variables, parameters of definitions, plain vehicles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from avrare.logic.complaints import complain, guess

_CLOSE = 0.75


@dataclass(frozen=True)
class Scope:
    """The names around a place in a formula.

    Attributes:
        statement: Number of the statement that the place is in; it may use the ones before it.
        names: Quantified variables and parameters of that statement -> the vehicles they stand for.
        bound: Quantified vehicles, of the statements that use this one too -> (depth, group).
    """

    statement: int
    names: Mapping[str, str] = field(default_factory=dict)
    bound: Mapping[str, tuple[int, str]] = field(default_factory=dict)

    def quantify(self, variable: str, group: str, words: set[str]) -> tuple[str, Scope]:
        """The name of a new quantified vehicle, and the scope of the quantifier's body.

        It is renamed if the formula that a definition is used in has given the name another meaning.

        Args:
            variable: As written.
            group: What it ranges over.
            words: All words of the text, which a new name must differ from.
        """
        vehicle = variable
        if variable in {*self.bound, *self.names.values()}:
            taken = words | set(self.bound)
            vehicle = next(new for k in range(2, len(taken) + 3) if (new := f"{variable}_{k}") not in taken)
        bound = {**self.bound, vehicle: (len(self.bound), group)}
        return vehicle, replace(self, names={**self.names, variable: vehicle}, bound=bound)

    def enter(self, statement: int, parameters: tuple[str, ...], vehicles: tuple[str, ...]) -> Scope:
        """The scope of a definition's body."""
        return Scope(statement, dict(zip(parameters, vehicles, strict=True)), self.bound)

    def vehicle(self, text: str, word: Any) -> str:
        """The vehicle that the argument ``word`` (a token) stands for.

        Raises:
            FormulaError: It is a group, a misspelt variable, or one that is bound where a definition is used.
        """
        name = str(word)
        if name in self.names:
            return self.names[name]
        self.refuse_capture(text, word)
        groups = {"others", *(group for _, group in self.bound.values())}
        if name in groups:
            hint = f"write: forall o in {name}: ... with o as the argument"
            raise complain(text, word, f"{name} is a group, not a vehicle", hint)
        known = {*self.names, *self.bound} - {"ego"}
        close = guess(name, known, _CLOSE) if name != "ego" else None
        if close:
            hint = f"did you mean {close!r}? if not, give the quantified variable another name"
            raise complain(text, word, f"no quantifier binds {name}", hint)
        return name

    def refuse_capture(self, text: str, word: Any) -> None:
        """Refuse a name that a quantifier outside the definition binds.

        Raises:
            FormulaError: It is such a name.
        """
        if str(word) in self.bound and str(word) not in self.names:
            message = f"{word} is not the one of the quantifier that this definition is used under"
            hint = f"make {word} a parameter of the definition, as in: name({word}) = ..."
            raise complain(text, word, message, hint)
