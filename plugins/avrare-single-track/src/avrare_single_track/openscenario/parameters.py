"""Parameters of a file, and the numbers that its attributes are: written, or expressions of parameters."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.protocols import Floats
from avrare_single_track.openscenario.xml_tree import Element

Number: TypeAlias = int
"""Number of a file, as its column in the table of all of them."""
_REFERENCE = re.compile(r"\$([A-Za-z_]\w*)")
_LONGEST = 300
"""Longest expression [characters]."""
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "round": (1, np.round),
    "floor": (1, np.floor),
    "ceil": (1, np.ceil),
    "sqrt": (1, np.sqrt),
    "pow": (2, np.power),
    "abs": (1, np.abs),
    "sign": (1, np.sign),
    "min": (2, np.minimum),
    "max": (2, np.maximum),
}
"""Functions of an expression, with the number of their arguments."""


class Parameters:
    """Parameters that a file declares, with the values that a scenario gives them.

    Args:
        declarations: The element ``ParameterDeclarations``, if there is one.
        given: Values by name; those of drawn parameters are replaced rollout by rollout.
        where: Name of the file, for messages.

    Attributes:
        values: Value of each, as text or number.
        decisive: Those that decide what a file means, such as a lane, and so cannot be drawn.

    Raises:
        UsageError: A value is given for a parameter that is not declared.
    """

    def __init__(self, declarations: Element | None, given: Mapping[str, float | str], where: str) -> None:
        self.values: dict[str, float | str] = {}
        self.decisive: set[str] = set()
        self._trees: list[ast.expr | float] = []
        self._lowest: dict[Number, float] = {}
        for one in declarations.list("ParameterDeclaration") if declarations is not None else []:
            one.get("parameterType")
            self.values[one.attribute("name")] = one.attribute("value")
        for name, value in given.items():
            if name not in self.values:
                raise UsageError(
                    f"{where}: no parameter {name!r} is declared", did_you_mean(name, self.values)
                )
            self.values[name] = value

    def text(self, element: Element, name: str) -> str:
        """Return an attribute, or the text of the parameter that it refers to."""
        written = element.attribute(name)
        reference = _REFERENCE.fullmatch(written)
        if reference is None:
            return written
        self.decisive.add(reference[1])
        return str(self._value(element, name, reference[1]))

    def number(
        self, element: Element, name: str, default: float | None = None, low: float | None = None
    ) -> Number:
        """Return an attribute as a number that may depend on parameters, and is never below ``low``."""
        written = element.get(name)
        if written is None and default is not None:
            return self.constant(default)
        tree = self._parse(element, name, element.attribute(name))
        self._trees.append(tree)
        with np.errstate(all="ignore"):
            value = self._evaluate(tree, self._numbers())
        if not np.isfinite(value):
            raise element.error(f"{name}: {written} is no finite number")
        if low is not None:
            if value < low:
                raise element.error(f"{name} should be at least {low:g}, found {value:g}")
            self._lowest[len(self._trees) - 1] = low
        return len(self._trees) - 1

    def constant(self, value: float) -> Number:
        """Return a number that is the same in every rollout."""
        self._trees.append(value)
        return len(self._trees) - 1

    def shifted(self, number: Number, by: float) -> Number:
        """Return a number that is ``by`` more than another."""
        tree = self._trees[number]
        if not by:
            return number
        if isinstance(tree, float):
            return self.constant(tree + by)
        self._trees.append(ast.BinOp(tree, ast.Add(), ast.Constant(by)))
        return len(self._trees) - 1

    def whole(self, element: Element, name: str) -> int:
        """Return an attribute that must be a whole number, and decides what a file means."""
        text = self.text(element, name)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not value.is_integer():
            raise element.error(f"{name} should be a whole number, found {text!r}")
        return int(value)

    def table(self, values: Mapping[str, Floats], n: int) -> Floats:
        """Return (n, K) all numbers, with drawn values (n,) of some parameters.

        NaN stands for a number that is less than it may be.
        """
        known = {**self._numbers(), **values}
        table = np.empty((n, len(self._trees)))
        with np.errstate(all="ignore"):
            for column, tree in enumerate(self._trees):
                table[:, column] = self._evaluate(tree, known)
        for column, low in self._lowest.items():
            table[table[:, column] < low, column] = np.nan
        return table

    def _numbers(self) -> dict[str, Any]:
        found = {}
        for name, value in self.values.items():
            try:
                found[name] = float(value)
            except ValueError:
                continue
        return found

    def _value(self, element: Element, name: str, parameter: str) -> float | str:
        if parameter not in self.values:
            hint = did_you_mean(parameter, self.values)
            raise element.error(f"{name}: no parameter {parameter!r} is declared", hint)
        return self.values[parameter]

    def _parse(self, element: Element, name: str, written: str) -> ast.expr | float:
        with suppress(ValueError):
            return float(written)
        for parameter in _REFERENCE.findall(written):
            value = self._value(element, name, parameter)
            if not isinstance(value, float | int) and not _is_number(value):
                raise element.error(f"{name}: the parameter {parameter!r} is no number: {value!r}")
        inner = written.strip()
        inner = inner[2:-1] if inner.startswith("${") and inner.endswith("}") else inner
        try:
            if len(inner) > _LONGEST or "__" in inner:
                raise ValueError
            tree = ast.parse(_REFERENCE.sub(r"\1", inner), mode="eval").body
            _check(tree, frozenset(_REFERENCE.findall(inner)))
        except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
            text = f"{name}: {written[:80]!r} is neither a number nor an expression"
            raise element.error(text, "such as $speed or ${2 * $speed + 1}") from None
        return tree

    def _evaluate(self, tree: ast.expr | float, known: Mapping[str, object]) -> Any:
        match tree:
            case float() | int():
                return tree
            case ast.Constant():
                return float(tree.value)  # type: ignore[arg-type]
            case ast.Name():
                return known[tree.id]
            case ast.BinOp():
                return _OPERATORS[type(tree.op)](
                    self._evaluate(tree.left, known), self._evaluate(tree.right, known)
                )
            case ast.UnaryOp():
                return _OPERATORS[type(tree.op)](self._evaluate(tree.operand, known))
            case ast.Call(func=ast.Name(id=name)):
                return _FUNCTIONS[name][1](*(self._evaluate(one, known) for one in tree.args))
        raise AssertionError(tree)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _check(tree: ast.expr, names: frozenset[str]) -> None:
    match tree:
        case ast.Constant(value=int() | float() as value):
            float(value)  # an integer may be too large
        case ast.Name() if tree.id in names:
            return
        case ast.BinOp() if type(tree.op) in _OPERATORS:
            _check(tree.left, names)
            _check(tree.right, names)
        case ast.UnaryOp() if type(tree.op) in _OPERATORS:
            _check(tree.operand, names)
        case ast.Call(func=ast.Name(id=name), keywords=[]) if name in _FUNCTIONS:
            if len(tree.args) != _FUNCTIONS[name][0]:
                raise ValueError
            for one in tree.args:
                _check(one, names)
        case _:
            raise ValueError
