"""Lark's tree to a formula: definitions expanded, formulas told from terms, bounds in samples."""

from __future__ import annotations

import math
from typing import Any

from avrare.logic import formula as f
from avrare.logic.bounds import Period, sample_bounds
from avrare.logic.complaints import complain, guess
from avrare.logic.definitions import Definition, Definitions
from avrare.logic.scope import Scope
from avrare.logic.tokens import FUNCTIONS, MEANING, WORDS

MAX_PARTS = 100_000
"""A formula with more parts, which only definitions of definitions can have, is refused."""

_ARITY = {"abs": 1, "sqrt": 1, "exp": 1, "log": 1, "pow": 2}
_MISSPELT, _ALIKE = 0.8, 0.7


def meaning(token: Any) -> str:
    """The operator that a token spells."""
    return MEANING.get(str(token), str(token))


class Reader:
    """Reads the statements of one text."""

    def __init__(self, text: str, period: Period, definitions: Definitions, words: set[str]) -> None:
        self.text = text
        self.period = period
        self.definitions = definitions
        self.words = words
        self.scope = Scope(0)
        self.parts = 0

    def read(self) -> f.Node:
        """The formula of the last statement; the others are read too, for their errors.

        Raises:
            FormulaError: With line, column, the line itself and a mark below the place.
        """
        last = self.definitions.last
        for found in self.definitions.all.values():
            if found is not last:
                self._expand(found, found.parameters, Scope(found.index))
        self.scope = Scope(last.index)
        return self.formula(last.body)

    def formula(self, tree: Any) -> f.Node:
        """The tree as a formula; a bare term is a predicate."""
        item = self.item(tree)
        return f.Predicate(item) if isinstance(item, f.Term) else item

    def term(self, tree: Any) -> f.Term:
        """The tree as a term."""
        item = self.item(tree)
        if isinstance(item, f.Term):
            return item
        hint = "compare terms, join formulas with and, or, ->"
        raise complain(self.text, _inside(tree).meta, "a number is needed here, not a formula", hint)

    def item(self, tree: Any) -> f.Node | f.Term:
        """The tree as whichever it is."""
        self.parts += 1
        tree = _inside(tree)
        if self.parts > MAX_PARTS:
            message = f"the formula has more than {MAX_PARTS} parts once its definitions are filled in"
            raise complain(self.text, tree.meta, message, "give its parts as signals")
        method = getattr(self, f"_{tree.data}")
        item: f.Node | f.Term = method(tree, *tree.children)
        return item

    def _quantified(self, tree: Any, op: Any, *rest: Any) -> f.Node:
        *count, variable, _, group, body = rest
        self._require_new(variable)
        outer = self.scope
        vehicle, self.scope = outer.quantify(str(variable), str(group), self.words)
        child = self.formula(body)
        self.scope = outer
        number = self._count(count[0]) if count else 1
        node = f.Quantifier(str(op), vehicle, str(group), child, len(outer.bound), number)
        self._require_use(node, variable)
        return node

    def _require_new(self, variable: Any) -> None:
        if str(variable) in self.scope.names:
            hint = "give the inner one another name"
            raise complain(self.text, variable, f"{variable} already stands for a vehicle here", hint)
        if str(variable) in self.definitions.all:
            hint = "give the variable another name"
            raise complain(self.text, variable, f"{variable} is the name of a definition", hint)

    def _require_use(self, node: f.Quantifier, variable: Any) -> None:
        """A plain signal may hold a value per vehicle; relations say which vehicles they are about."""
        found = [part for part in f.walk(node.child) if isinstance(part, f.Signal)]
        if not any(node.depth in signal.axes or not signal.arguments for signal in found):
            hint = f"use {variable} as an argument, as in: distance({variable}, ego) > 0"
            raise complain(self.text, variable, f"nothing after the colon depends on {variable}", hint)

    def _count(self, token: Any) -> int:
        if token.type == "NAME":
            token = self.definitions.number(token, self.scope.statement)
        value = float(token)
        if not (1 <= value < 1e9 and value.is_integer()):
            raise complain(self.text, token, f"at_least counts vehicles: {token} is no whole number above 0")
        return int(value)

    def _connective(self, tree: Any, left: Any, op: Any, right: Any) -> f.Node:
        return f.Connective(meaning(op), self.formula(left), self.formula(right))

    def _implication(self, tree: Any, left: Any, op: Any, right: Any, *more: Any) -> f.Node:
        if more:
            hint = "write (a -> b) -> c or a -> (b -> c): tools differ on which is meant"
            raise complain(self.text, more[0], "'->' does not chain", hint)
        return f.Connective("implies", self.formula(left), self.formula(right))

    def _until(self, tree: Any, left: Any, op: Any, *rest: Any) -> f.Node:
        lo, hi = self._bounds(rest)
        return f.Until(meaning(op), lo, hi, self.formula(left), self.formula(rest[-1]))

    def _negation(self, tree: Any, op: Any, child: Any) -> f.Node:
        return f.Not(self.formula(child))

    def _window(self, tree: Any, op: Any, *rest: Any) -> f.Node:
        lo, hi = self._bounds(rest)
        return f.Window(meaning(op), lo, hi, self.formula(rest[-1]))

    def _step(self, tree: Any, op: Any, child: Any) -> f.Node:
        return f.Step(meaning(op), self.formula(child))

    _edge = _step

    def _bounds(self, rest: Any) -> tuple[int, float]:
        if len(rest) == 1:
            return 0, math.inf
        statement = self.scope.statement
        return sample_bounds(
            self.text, rest[0], self.period, lambda name: self.definitions.number(name, statement)
        )

    def _compared(self, tree: Any, left: Any, op: Any, right: Any, *more: Any) -> f.Node:
        if more:
            hint = "write 0 < x and x < 3 for 0 < x < 3"
            raise complain(self.text, more[0], "comparisons do not chain", hint)
        return f.Comparison(meaning(op), self.term(left), self.term(right))

    def _arithmetic(self, tree: Any, left: Any, op: Any, right: Any) -> f.Term:
        return f.Arithmetic(str(op), self.term(left), self.term(right))

    def _negative(self, tree: Any, op: Any, operand: Any) -> f.Term:
        if operand.data == "number":
            return f.Number(-self._number(operand, *operand.children).value)
        return f.Negative(self.term(operand))

    def _number(self, tree: Any, token: Any) -> f.Number:
        value = float(token)
        if math.isinf(value):
            raise complain(self.text, token, "the number is too large")
        return f.Number(value)

    def _constant(self, tree: Any, word: Any) -> f.Node:
        return f.Constant(word == "true")

    def _call(self, tree: Any, name: Any, *arguments: Any) -> f.Term:
        function = meaning(name)
        wanted = _ARITY.get(function)
        if len(arguments) != wanted if wanted else len(arguments) < 2:
            count = f"{wanted} argument{'s' if wanted != 1 else ''}" if wanted else "two or more arguments"
            raise complain(self.text, name, f"{name} takes {count}, not {len(arguments)}")
        return f.Call(function, tuple(self.term(argument) for argument in arguments))

    def _signal(self, tree: Any, name: Any) -> f.Node | f.Term:
        if str(name) in self.scope.names:
            hint = f"use it as an argument, as in: distance({name}, ego) > 0"
            raise complain(self.text, name, f"{name} stands for a vehicle, not for a number", hint)
        found = self.definitions.visible(str(name), name, self.scope.statement)
        if found is not None:
            return self._use(found, name, ())
        self.scope.refuse_capture(self.text, name)
        return f.Signal(str(name))

    def _relation(self, tree: Any, name: Any, opening: Any, *arguments: Any) -> f.Node | f.Term:
        found = self.definitions.visible(str(name), name, self.scope.statement)
        if found is None:
            self._refuse_misspelt(name, opening, arguments)
        vehicles = tuple(self._vehicle(name, argument) for argument in arguments)
        if found is not None:
            return self._use(found, name, vehicles)
        bound = self.scope.bound
        groups = [bound[vehicle][1] if vehicle in bound else vehicle for vehicle in vehicles]
        axes = tuple(bound[vehicle][0] for vehicle in vehicles if vehicle in bound)
        return f.Signal(f"{name}({', '.join(groups)})", vehicles, axes)

    def _refuse_misspelt(self, name: Any, opening: Any, arguments: Any) -> None:
        """A name before a parenthesis is a relation unless it looks like an operator or function instead."""
        trees = [_inside(argument) for argument in arguments]
        words = [str(tree.children[0]) for tree in trees if tree.data == "signal"]
        if any(word == "ego" or word in self.scope.names for word in words):
            return
        plain = all(tree.data in ("signal", "number", "negative") for tree in trees)
        close = guess(str(name), [*WORDS, *FUNCTIONS], _MISSPELT if plain else _ALIKE)
        if close or not plain:
            hint = f"did you mean {close!r}?" if close else "relations are about vehicles: distance(o, ego)"
            message = f"'(' does not fit here: {name} is no operator or function"
            raise complain(self.text, opening, message, hint)

    def _vehicle(self, name: Any, argument: Any) -> str:
        tree = _inside(argument)
        if tree.data != "signal":
            numeric = tree.data in ("number", "negative")
            message = f"{name} is about vehicles, not about {'numbers' if numeric else 'formulas'}"
            raise complain(self.text, tree.meta, message, f"compare its value: {name}(o, ego) > 3")
        return self.scope.vehicle(self.text, tree.children[0])

    def _use(self, found: Definition, name: Any, vehicles: tuple[str, ...]) -> f.Node | f.Term:
        wanted = len(found.parameters)
        if len(vehicles) != wanted:
            shown = f"{name}({', '.join(found.parameters)})" if wanted else str(name)
            message = (
                f"{name} takes {wanted or 'no'} argument{'s' if wanted != 1 else ''}, not {len(vehicles)}"
            )
            raise complain(self.text, name, message, f"it is defined as {shown}")
        return self._expand(found, vehicles, self.scope)

    def _expand(self, found: Definition, vehicles: tuple[str, ...], outer: Scope) -> f.Node | f.Term:
        self.scope = outer.enter(found.index, found.parameters, vehicles)
        item = self.item(found.body)
        self.scope = outer
        return item


def _inside(tree: Any) -> Any:
    """The tree without the parentheses around it."""
    while tree.data == "group":
        tree = tree.children[0]
    return tree
