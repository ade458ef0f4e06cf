"""Transformer from lark's tree to a formula: expands definitions, converts bounds to samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from avrare.logic.syntax import nodes
from avrare.logic.syntax.definitions import Definition, Definitions, Scope, get_subtree, get_token
from avrare.logic.syntax.places import PlacedError
from avrare.logic.syntax.syntax_errors import suggest
from avrare.logic.syntax.token_classes import FUNCTIONS, MEANING, WORDS

if TYPE_CHECKING:
    from lark import Token, Tree

MAX_SAMPLES = 10**14
"""Largest bound in samples: more must be a mistake and cannot index an array."""

_SECONDS = {"s": Fraction(1), "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9)}
_CHAINS = {
    "comparison": ("comparisons do not chain", "write 0 < x and x < 3 for 0 < x < 3"),
    "implication": (
        "'->' does not chain",
        "write (a -> b) -> c or a -> (b -> c): tools differ in which they read",
    ),
}
_MISSPELT, _SIMILAR = 0.8, 0.7


def _operator(token: Token) -> str:
    return MEANING.get(token.replace(" ", ""), str(token))


class FormulaTransformer:
    """Transformer of the statements of one text, whose ``words`` new names of vehicles must differ from."""

    def __init__(self, period: Fraction, definitions: Definitions, words: set[str]) -> None:
        self.period = period
        self.definitions = definitions
        self.words = words
        self.scope = Scope(0)
        self.parts = 0

    def transform(self) -> nodes.Node:
        """Return the formula of the last statement; the others are checked too."""
        last = self.definitions.last
        for definition in self.definitions.all.values():
            if definition is not last:
                self._expand(definition, definition.parameters, Scope(definition.index))
        self.scope = Scope(last.index)
        return self._formula(last.body)

    def _formula(self, tree: Tree[Token]) -> nodes.Node:
        element = self._element(tree)
        return nodes.Predicate(element) if isinstance(element, nodes.Term) else element

    def _term(self, tree: Tree[Token]) -> nodes.Term:
        element = self._element(tree)
        if isinstance(element, nodes.Term):
            return element
        hint = "compare terms, join formulas with and, or, ->"
        raise PlacedError(_strip_groups(tree).meta, "expected a number, not a formula", hint)

    def _element(self, tree: Tree[Token]) -> nodes.Node | nodes.Term:
        self.parts += 1
        tree = _strip_groups(tree)
        most_parts = 100_000  # larger formulas, which only nested definitions can make, are refused
        if self.parts > most_parts:
            message = f"the formula has more than {most_parts} parts once its definitions are expanded"
            hint = "compute parts of the formula as signals of the system"
            raise PlacedError(tree.meta, message, hint)
        if tree.data in _CHAINS and len(tree.children) > 3:
            raise PlacedError(get_token(tree, 3), *_CHAINS[tree.data])
        element: nodes.Node | nodes.Term = getattr(self, f"_{tree.data}")(*tree.children)
        return element

    def _quantifier(
        self, op: Token, variable: Token, _in: Token, group: Token, body: Tree[Token], count: int = 1
    ) -> nodes.Node:
        # 1. A new name.
        if str(variable) in self.scope.names:
            hint = "give the inner one another name"
            raise PlacedError(variable, f"{variable} already stands for a vehicle here", hint)
        if str(variable) in self.definitions.all:
            hint = "give the variable another name"
            raise PlacedError(variable, f"{variable} is the name of a definition", hint)
        # 2. The body.
        outer = self.scope
        vehicle, self.scope = outer.quantify(str(variable), str(group), self.words)
        child = self._formula(body)
        self.scope = outer
        depth = len(outer.bound)
        # 3. Its use; a plain signal may hold a value per vehicle.
        signals = [part for part in nodes.walk(child) if isinstance(part, nodes.Signal)]
        if not any(depth in signal.axes or not signal.arguments for signal in signals):
            hint = f"use {variable} as an argument, as in: distance({variable}, ego) > 0"
            raise PlacedError(variable, f"nothing after the colon depends on {variable}", hint)
        return nodes.Quantifier(str(op), vehicle, str(group), child, depth, count)

    def _counted(
        self, op: Token, number: Token, variable: Token, _in: Token, group: Token, body: Tree[Token]
    ) -> nodes.Node:
        token = self._resolve_number(number) if number.type == "NAME" else number
        count = float(token)
        if not (1 <= count < 1e9 and count.is_integer()):
            raise PlacedError(token, f"at_least needs a whole number above 0, not {token}")
        return self._quantifier(op, variable, _in, group, body, int(count))

    def _connective(self, left: Tree[Token], op: Token, right: Tree[Token]) -> nodes.Node:
        return nodes.Connective(_operator(op), self._formula(left), self._formula(right))

    _implication = _connective

    def _until(self, left: Tree[Token], op: Token, *rest: Tree[Token]) -> nodes.Node:
        lo, hi = self._bounds(rest)
        return nodes.Until(_operator(op), lo, hi, self._formula(left), self._formula(rest[-1]))

    def _negation(self, op: Token, child: Tree[Token]) -> nodes.Node:
        return nodes.Not(self._formula(child))

    def _window(self, op: Token, *rest: Tree[Token]) -> nodes.Node:
        lo, hi = self._bounds(rest)
        return nodes.Window(_operator(op), lo, hi, self._formula(rest[-1]))

    def _step(self, op: Token, child: Tree[Token]) -> nodes.Node:
        return nodes.Step(_operator(op), self._formula(child))

    _edge = _step

    def _bounds(self, rest: Sequence[Tree[Token]]) -> tuple[int, float]:
        # A bound without a unit is in seconds, except that the left one inherits the unit of the right one.
        if len(rest) == 1:
            return 0, math.inf
        left, right = get_subtree(rest[0], 0), get_subtree(rest[0], 1)
        lo = self._samples(left, str(right.children[1]) if len(right.children) > 1 else "s")
        hi = self._samples(right, "s")
        if math.isinf(lo):
            hint = "only the second bound may be inf"
            raise PlacedError(left.meta, "the first bound is infinite", hint)
        if lo > hi:
            raise PlacedError(rest[0].meta, "the first bound is larger than the second")
        return int(lo), hi

    def _samples(self, bound: Tree[Token], unit: str) -> float:
        token = get_token(bound, 0)
        if token == "inf":
            return math.inf
        if token.type == "NAME":
            token = self._resolve_number(token)
        unit = str(bound.children[1]) if len(bound.children) > 1 else unit
        if not _fits_float(token):
            raise PlacedError(bound.meta, "the bound is out of range")
        if unit.startswith("sample"):
            samples, wrong = Fraction(token), "the bound is not a whole number of samples"
        else:
            samples = Fraction(token) * _SECONDS[unit] / self.period
            wrong = f"{token} {unit} is not a whole multiple of dt = {float(self.period):g} s"
        if samples.denominator != 1:
            nearest = float(round(samples) * self.period)
            hint = f"the nearest sample is at {nearest:g} s; or give samples, as in [0:3 samples]"
            raise PlacedError(bound.meta, wrong, hint)
        if samples > MAX_SAMPLES:
            message = f"out of range: above {MAX_SAMPLES:g} samples"
            raise PlacedError(bound.meta, message, "write inf")
        return int(samples)

    def _resolve_number(self, token: Token) -> Token:
        # The number that a name stands for.
        definition = self.definitions.look_up(token, self.scope.statement)
        if definition is None or definition.body.data != "number":
            message = f"{token} is {'not a number of zero or above' if definition else 'not defined'}"
            raise PlacedError(token, message, f"define it above: const float {token} = 3")
        return get_token(definition.body, 0)

    def _comparison(self, left: Tree[Token], op: Token, right: Tree[Token]) -> nodes.Node:
        return nodes.Comparison(_operator(op), self._term(left), self._term(right))

    def _arithmetic(self, left: Tree[Token], op: Token, right: Tree[Token]) -> nodes.Term:
        return nodes.Arithmetic(str(op), self._term(left), self._term(right))

    def _negative(self, op: Token, operand: Tree[Token]) -> nodes.Term:
        if operand.data == "number":
            return nodes.Number(-self._number(get_token(operand, 0)).value)
        return nodes.Negative(self._term(operand))

    def _number(self, token: Token) -> nodes.Number:
        value = float(token)
        if math.isinf(value):
            raise PlacedError(token, "the number is too large")
        return nodes.Number(value)

    def _constant(self, word: Token) -> nodes.Node:
        return nodes.Constant(word == "true")

    def _call(self, name: Token, *arguments: Tree[Token]) -> nodes.Term:
        function = _operator(name)
        arity = {"abs": 1, "sqrt": 1, "exp": 1, "log": 1, "pow": 2}.get(function)
        if len(arguments) != arity if arity else len(arguments) < 2:
            count = f"{arity} argument{'s' if arity != 1 else ''}" if arity else "two or more arguments"
            raise PlacedError(name, f"{name} takes {count}, not {len(arguments)}")
        return nodes.Call(function, tuple(self._term(argument) for argument in arguments))

    def _signal(self, name: Token) -> nodes.Node | nodes.Term:
        if str(name) in self.scope.names:
            hint = f"use it as an argument, as in: distance({name}, ego) > 0"
            raise PlacedError(name, f"{name} stands for a vehicle, not for a number", hint)
        definition = self.definitions.look_up(name, self.scope.statement)
        if definition is not None:
            return self._use(definition, name, ())
        self.scope.refuse_capture(name)
        return nodes.Signal(str(name))

    def _relation(self, name: Token, opening: Token, *arguments: Tree[Token]) -> nodes.Node | nodes.Term:
        definition = self.definitions.look_up(name, self.scope.statement)
        if definition is None:
            self._refuse_misspelt(name, opening, arguments)
        vehicles = tuple(self._vehicle(name, argument) for argument in arguments)
        if definition is not None:
            return self._use(definition, name, vehicles)
        bound = self.scope.bound
        groups = [bound[vehicle][1] if vehicle in bound else vehicle for vehicle in vehicles]
        axes = tuple(bound[vehicle][0] for vehicle in vehicles if vehicle in bound)
        return nodes.Signal(f"{name}({', '.join(groups)})", vehicles, axes)

    def _refuse_misspelt(self, name: Token, opening: Token, arguments: Sequence[Tree[Token]]) -> None:
        trees = [_strip_groups(argument) for argument in arguments]
        words = [str(get_token(tree, 0)) for tree in trees if tree.data == "signal"]
        if any(word == "ego" or word in self.scope.names for word in words):
            return
        plain = all(tree.data in ("signal", "number", "negative") for tree in trees)
        close = suggest(str(name), [*WORDS, *FUNCTIONS], _MISSPELT if plain else _SIMILAR)
        if close or not plain:
            hint = f"did you mean {close!r}?" if close else "relations take vehicles: distance(o, ego)"
            message = f"unexpected '(': {name} is not an operator or function"
            raise PlacedError(opening, message, hint)

    def _vehicle(self, name: Token, argument: Tree[Token]) -> str:
        tree = _strip_groups(argument)
        if tree.data != "signal":
            numeric = tree.data in ("number", "negative")
            message = f"{name} takes vehicles, not {'numbers' if numeric else 'formulas'}"
            raise PlacedError(tree.meta, message, f"compare its value: {name}(o, ego) > 3")
        return self.scope.resolve_vehicle(get_token(tree, 0))

    def _use(self, definition: Definition, name: Token, vehicles: tuple[str, ...]) -> nodes.Node | nodes.Term:
        arity = len(definition.parameters)
        if len(vehicles) != arity:
            call = f"{name}({', '.join(definition.parameters)})" if arity else str(name)
            count = f"{arity or 'no'} argument{'s' if arity != 1 else ''}"
            message = f"{name} takes {count}, not {len(vehicles)}"
            raise PlacedError(name, message, f"it is defined as {call}")
        return self._expand(definition, vehicles, self.scope)

    def _expand(
        self, definition: Definition, vehicles: tuple[str, ...], outer: Scope
    ) -> nodes.Node | nodes.Term:
        self.scope = outer.enter(definition.index, definition.parameters, vehicles)
        element = self._element(definition.body)
        self.scope = outer
        return element


def _strip_groups(tree: Tree[Token]) -> Tree[Token]:
    while tree.data == "group":
        tree = get_subtree(tree, 0)
    return tree


def _fits_float(token: str) -> bool:
    # Checked before conversion: the exact fraction of 1e999999999 would exhaust the memory.
    if len(token) > 400:
        return False
    value = float(token)
    mantissa = token.lower().split("e")[0]
    return math.isfinite(value) and (value != 0 or float(mantissa) == 0)
