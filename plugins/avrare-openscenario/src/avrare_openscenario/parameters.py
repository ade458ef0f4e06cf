"""Parameters of a file, and the numbers that its attributes are: written, or expressions of parameters."""

from __future__ import annotations

import ast
import functools
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeAlias, TypeVar

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.protocols import Floats
from avrare_openscenario.xml_tree import Element

Choice = TypeVar("Choice", bound=str)
Number: TypeAlias = int
"""Number of a file, as its column in the table of all of them."""
REFERENCE = re.compile(r"\$([A-Za-z_]\w*)")
"""Parameter in a text."""
_OPERATORS: dict[type, np.ufunc] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.USub: np.negative,
    ast.Not: np.logical_not,
    ast.UAdd: np.positive,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
}
_FUNCTIONS: dict[str, np.ufunc] = {
    "round": np.rint,
    "pow": np.power,
    "abs": np.absolute,
    "min": np.minimum,
    "max": np.maximum,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
} | {
    function.__name__: function for function in (np.floor, np.ceil, np.sqrt, np.sign, np.sin, np.cos, np.tan)
}
"""Functions of an expression."""
_TEXTS = 1e9
"""Number that stands for the first text among values of variables."""
_CONSTANTS = {"pi": math.pi, "true": 1.0, "false": 0.0}
_RULES: dict[str, Callable[..., Any]] = {
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
    "equalTo": np.equal,
    "notEqualTo": np.not_equal,
}
"""Rules of a constraint; of texts, only the last two."""
_Bound: TypeAlias = tuple[str, ast.expr | float | str]
"""Rule and limit of a constraint."""
_Constraint: TypeAlias = tuple[str, list[list[_Bound]]]
"""Parameter, and groups of bounds of which one must hold."""


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
        self._derived: dict[str, ast.expr] = {}
        self._constraints: list[_Constraint] = []
        self._texts: list[str] = []
        self._given = given
        self._names: dict[str, str] = {}
        self.declare(declarations)
        for name in given:
            if name not in self.values:
                raise UsageError(
                    f"{where}: no parameter {name!r} is declared", did_you_mean(name, self.values)
                )

    def declare(self, declarations: Element | None) -> None:
        """Add the parameters that an element has; they hide others of the same names."""
        elements = declarations.list("ParameterDeclaration") if declarations is not None else []
        for element in elements:
            element.get("parameterType")
            name = element.attribute("name")
            value = self._given[name] if name in self._given else self._declare(element, name)
            if self.values.get(name, value) != value:
                self._names[name] = f"{name}_{len(self.values)}"
            self.values[self._names.get(name, name)] = value
        for element in elements:
            self._read_constraints(element)

    @contextmanager
    def scope(self, declarations: Element | None) -> Iterator[None]:
        """Add parameters that hold within an element."""
        names = dict(self._names)
        self.declare(declarations)
        yield
        self._names = names

    def _declare(self, element: Element, name: str) -> float | str:
        # Value of a declaration, which may refer to those before it.
        written = element.attribute("value")
        reference = REFERENCE.fullmatch(written)
        if reference is not None and not _is_number(str(self._value(element, "value", reference[1]))):
            return self.text(element, "value")
        if "$" not in written:
            return written
        tree = self._parse(element, "value", written)
        if isinstance(tree, float):
            return tree
        self._derived[name] = tree
        return self._compute(element, "value", tree)

    def _read_constraints(self, element: Element) -> None:
        # One group of constraints must hold as a whole.
        name = element.attribute("name")
        groups = [
            [self._read_bound(value, name) for value in group.list("ValueConstraint")]
            for group in element.list("ConstraintGroup")
        ]
        if not groups:
            return
        self._constraints.append((name, groups))
        if not self._fits(self._constraints[-1], {**self.values, **self._numbers()}):
            text = f"the value {self.values[name]} of {name!r} is outside its ConstraintGroup"
            raise element.error(text, "give another value under `parameters`")

    def _read_bound(self, value: Element, name: str) -> _Bound:
        rule, written = value.attribute("rule"), value.attribute("value")
        if rule not in _RULES:
            raise value.error(f"rule should be one of {', '.join(_RULES)}, found {rule!r}")
        if _is_number(str(self.values[name])):
            return rule, self._parse(value, "value", written)
        if rule not in ("equalTo", "notEqualTo"):
            raise value.error(f"the parameter {name!r} is no number: {self.values[name]!r}")
        return rule, written

    def _fits(self, constraint: _Constraint, scope: Mapping[str, object]) -> Any:
        name, groups = constraint
        value, fits = scope[name], np.False_
        for group in groups:
            bounds = [bound if isinstance(bound, str) else self._evaluate(bound, scope) for _, bound in group]
            meets = [_RULES[rule](value, bound) for (rule, _), bound in zip(group, bounds, strict=True)]
            fits = np.logical_or(fits, functools.reduce(np.logical_and, meets, np.True_))
        return fits

    def text(self, element: Element, name: str) -> str:
        """Return an attribute, or the text of the parameter that it refers to."""
        written = element.attribute(name)
        reference = REFERENCE.fullmatch(written)
        if reference is None:
            return written
        self.decisive.add(reference[1])
        return str(self._value(element, name, reference[1]))

    def path(self, element: Element, name: str) -> str:
        """Return an attribute as a path beside the file of its element; backslashes are slashes."""
        return os.path.join(os.path.dirname(element.path), self.text(element, name).replace("\\", "/"))

    def choose(
        self, element: Element, name: str, choices: Sequence[Choice], default: Choice | None = None
    ) -> Choice:
        """Return an attribute that must be one of some words."""
        if default is not None and element.get(name) is None:
            return default
        text = self.text(element, name)
        for choice in choices:
            if choice == text:
                return choice
        raise element.error(f"{name} should be one of {', '.join(choices)}, found {text!r}")

    def boolean(self, element: Element, name: str) -> bool:
        """Return an attribute that is true or false, False where it is not there."""
        if element.get(name) is None:
            return False
        text = self.text(element, name)
        if text.lower() not in ("true", "false", "1", "0"):
            raise element.error(f"{name} should be one of true, false, 1, 0, found {text!r}")
        return text.lower() in ("true", "1")

    def number(
        self, element: Element, name: str, default: float | None = None, low: float | None = None
    ) -> Number:
        """Return an attribute as a number that may depend on parameters, and is never below ``low``."""
        if default is not None and element.get(name) is None:
            return self.constant(default)
        tree = self._parse(element, name, element.attribute(name))
        self._trees.append(tree)
        value = self._compute(element, name, tree)
        if low is not None:
            if value < low:
                raise element.error(f"{name} should be at least {low:g}, found {value:g}")
            self._lowest[len(self._trees) - 1] = low
        return len(self._trees) - 1

    def constant(self, value: float) -> Number:
        """Return a number that is the same in every rollout."""
        self._trees.append(value)
        return len(self._trees) - 1

    def value(self, element: Element, name: str) -> Number:
        """Return an attribute as a number, which stands for a text where it is one."""
        written = element.attribute(name)
        if "$" in written or _is_number(written) or written in _CONSTANTS:
            reference = REFERENCE.fullmatch(written)
            text = None if reference is None else str(self._value(element, name, reference[1]))
            if text is None or _is_number(text):
                return self.number(element, name)
            written = text
        if written in _CONSTANTS:
            return self.constant(_CONSTANTS[written])
        if written not in self._texts:
            self._texts.append(written)
        return self.constant(_TEXTS + self._texts.index(written))

    def scale(self, number: Number, factor: float, by: float) -> Number:
        """Return a number times a factor, plus ``by``."""
        tree = self._trees[number]
        if isinstance(tree, float):
            return self.constant(tree * factor + by)
        product = ast.BinOp(tree, ast.Mult(), ast.Constant(factor))
        self._trees.append(ast.BinOp(product, ast.Add(), ast.Constant(by)))
        return len(self._trees) - 1

    def shift(self, number: Number, by: float) -> Number:
        """Return a number plus ``by``."""
        return number if not by else self.scale(number, 1.0, by)

    def read_number(self, element: Element, name: str) -> float:
        """Read an attribute as a number that is known while the file is read."""
        tree = self._parse(element, name, element.attribute(name))
        self.decisive.update(REFERENCE.findall(element.attribute(name)))
        return self._compute(element, name, tree)

    def read_integer(self, element: Element, name: str) -> int:
        """Read an attribute as a whole number that is known while the file is read."""
        value = self.read_number(element, name)
        if not value.is_integer():
            raise element.error(f"{name} should be a whole number, found {element.attribute(name)!r}")
        return int(value)

    def table(self, values: Mapping[str, Floats], n: int) -> Floats:
        """Return (n, K) all numbers, with drawn values (n,) of some parameters.

        NaN stands for a number that is less than it may be, and for all of a row that a constraint forbids.
        """
        current = {**self.values, **self._numbers(), **values}
        table = np.empty((n, len(self._trees)))
        with np.errstate(all="ignore"):
            for name, derived in self._derived.items():
                if name not in values:
                    current[name] = self._evaluate(derived, current)
            for column, tree in enumerate(self._trees):
                table[:, column] = self._evaluate(tree, current)
        for constraint in self._constraints:
            table[~np.broadcast_to(self._fits(constraint, current), n)] = np.nan
        for column, low in self._lowest.items():
            table[table[:, column] < low, column] = np.nan
        return table

    def _numbers(self) -> dict[str, float]:
        return {name: float(value) for name, value in self.values.items() if _is_number(str(value))}

    def _value(self, element: Element, name: str, parameter: str) -> float | str:
        parameter = self._names.get(parameter, parameter)
        if parameter not in self.values:
            hint = did_you_mean(parameter, self.values)
            raise element.error(f"{name}: no parameter {parameter!r} is declared", hint)
        return self.values[parameter]

    def _parse(self, element: Element, name: str, written: str) -> ast.expr | float:
        with suppress(ValueError):
            return float(written)
        for parameter in REFERENCE.findall(written):
            value = self._value(element, name, parameter)
            if not isinstance(value, float | int) and not _is_number(value):
                raise element.error(f"{name}: the parameter {parameter!r} is no number: {value!r}")
        inner = written.strip()
        inner = inner[2:-1].strip() if inner.startswith("${") and inner.endswith("}") else inner
        try:
            longest = 2000  # longest expression [characters]
            if len(inner) > longest or "__" in inner:
                raise ValueError
            names = {name: self._names.get(name, name) for name in REFERENCE.findall(inner)}
            tree = ast.parse(REFERENCE.sub(lambda match: names[match[1]], inner), mode="eval").body
            with np.errstate(all="ignore"):
                self._evaluate(tree, dict.fromkeys(names.values(), 1.0))
        except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
            text = f"{name}: {written[:80]!r} is neither a number nor an expression"
            raise element.error(text, "such as $speed or ${2 * $speed + 1}") from None
        return tree

    def _compute(self, element: Element, name: str, tree: ast.expr | float) -> float:
        # Value of an attribute, before parameters are drawn.
        with np.errstate(all="ignore"):
            value = float(self._evaluate(tree, self._numbers()))
        if not math.isfinite(value):
            raise element.error(f"{name}: {element.attribute(name)} is no finite number")
        return value

    def _evaluate(self, tree: ast.expr | float, scope: Mapping[str, object]) -> Any:
        match tree:
            case float() | int():
                return tree
            case ast.Constant(value=int() | float() as value):
                return float(value)
            case ast.Name(id=name) if name in _CONSTANTS or name in scope:
                return _CONSTANTS.get(name, scope.get(name))
            case ast.BoolOp(op=sign, values=terms):
                return functools.reduce(
                    _OPERATORS[type(sign)], [self._evaluate(term, scope) for term in terms]
                )
            case ast.BinOp(op=sign) if type(sign) in _OPERATORS:
                terms = [self._evaluate(term, scope) for term in (tree.left, tree.right)]
                return _OPERATORS[type(sign)](*terms)
            case ast.UnaryOp(op=sign) if type(sign) in _OPERATORS:
                return _OPERATORS[type(sign)](self._evaluate(tree.operand, scope))
            case ast.Call(func=ast.Name(id=name), args=terms, keywords=[]) if name in _FUNCTIONS:
                if len(terms) == _FUNCTIONS[name].nin:
                    return _FUNCTIONS[name](*(self._evaluate(term, scope) for term in terms))
        raise ValueError


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
