"""Affine formulas: minima and maxima of affine margins, whose slices have a closed form.

In negation normal form a formula's robustness is below c exactly if the formula is violated after subtracting
c from all its margins. With the sign changes of each margin, this determines a slice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from avrare.base.errors import UsageError
from avrare.logic.formula import Formula
from avrare.logic.semantics.normal_form import normalise
from avrare.logic.semantics.trace_evaluator import Evaluator, compile_term
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Floats

Parts = tuple[tuple[float, nodes.Term | None], ...]
"""Sum of factors times signals or calls of min, max, abs; None is the constant 1."""


@dataclass(frozen=True)
class Margin:
    """Affine margin, factors x signals + constant, positive where the predicate holds.

    Attributes:
        factors: Pairs of a signal's name and its factor.
        constant: Constant term.
        term: Comparison that it comes from, where margins of several terms are kept apart; else None.
    """

    factors: tuple[tuple[str, float], ...]
    constant: float
    term: nodes.Comparison | None = None


@dataclass(frozen=True)
class Conjunct:
    """Part of a conjunction over time, which must hold in each of Q windows.

    Attributes:
        node: Formula in negation normal form; ``Slot(i)`` is margin ``used[i]``.
        used: Indices of its J margins.
        windows: (Q, W) samples of each window; the formula is evaluated at the first.
        closed: True if until needs its left operand at the witness.
    """

    node: nodes.Node
    used: tuple[int, ...]
    windows: np.ndarray
    closed: bool

    def find_violations(self, margins: Floats) -> np.ndarray:
        """Return where the margins (J, W, rows) violate the formula: (rows,)."""
        steps, rows = margins.shape[1:]
        slots = [np.ascontiguousarray(margin) for margin in margins]
        value = Evaluator({}, steps, rows, RobustnessAlgebra(), self.closed, slots)(self.node)
        return np.asarray(value[0] < 0.0)


@dataclass(frozen=True)
class AffineFormula:
    """Formula with affine predicates.

    Attributes:
        node: Formula in negation normal form over ``Slot(index)`` of the margins.
        margins: Margins of its predicates.
        closed: True if until needs its left operand at the witness.
    """

    node: nodes.Node
    margins: tuple[Margin, ...]
    closed: bool

    @staticmethod
    def of(formula: Formula, *, apart: bool = False) -> AffineFormula:
        """Convert a formula; ``apart`` keeps equal margins of different terms apart.

        Raises:
            UsageError: A term is not affine (sums, differences, constant factors, and abs, min, max of such),
                or the formula has iff, xor or quantifiers.
        """
        collector = _MarginCollector(apart)
        return AffineFormula(
            collector.node(normalise(formula.node)), tuple(collector.margins), formula.closed
        )

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that it reads."""
        return tuple(dict.fromkeys(name for margin in self.margins for name, _ in margin.factors))

    def conjuncts(self, steps: int) -> list[Conjunct]:
        """Split the formula at sample 0 of samples 0..steps into a conjunction."""
        return list(_conjuncts(self.node, steps, self.closed))

    def combine(self, names: Sequence[str], values: Floats, constant: bool = True) -> Floats:
        """Return the margins (..., P) of the signals ``names`` (..., n)."""
        out = np.zeros((*values.shape[:-1], len(self.margins)))
        for k, margin in enumerate(self.margins):
            for name, factor in margin.factors:
                out[..., k] += factor * values[..., names.index(name)]
            out[..., k] += margin.constant if constant else 0.0
        return out


class _MarginCollector:
    def __init__(self, apart: bool) -> None:
        self.margins: list[Margin] = []
        self.apart = apart
        self.term: nodes.Comparison | None = None

    def node(self, node: nodes.Node) -> nodes.Node:
        match node:
            case nodes.Comparison(op, left, right):
                self.term = node if self.apart else None
                above, below = (
                    _flatten(left, 1.0) + _flatten(right, -1.0),
                    _flatten(right, 1.0) + _flatten(left, -1.0),
                )
                if op in ("==", "!="):
                    return nodes.Connective(
                        "and" if op == "==" else "or", self.lattice(above), self.lattice(below)
                    )
                return self.lattice(above if op in (">", ">=") else below)
            case nodes.Connective("iff" | "xor" as op):
                raise UsageError(f"{op} has no exact slices", "write it with and, or, not")
            case nodes.Quantifier() | nodes.Not():
                raise UsageError("quantifiers have no exact slices", "write a formula for each vehicle")
            case _:
                return nodes.rebuild(node, self.node)

    def lattice(self, parts: Parts) -> nodes.Node:
        for k, (factor, term) in enumerate(parts):
            if isinstance(term, nodes.Call):
                (first, *_) = arguments = term.arguments
                choices = (first, nodes.Negative(first)) if term.function == "abs" else arguments
                upper = (term.function != "min") == (factor > 0.0)
                sums = [self.lattice((*parts[:k], *_flatten(c, factor), *parts[k + 1 :])) for c in choices]
                return reduce(lambda a, b: nodes.Connective("or" if upper else "and", a, b), sums)
        return self.slot(parts)

    def slot(self, parts: Parts) -> nodes.Node:
        # Equal margins share a slot.
        factors: dict[str, float] = {}
        constant = 0.0
        for factor, term in parts:
            if isinstance(term, nodes.Signal):
                factors[term.name] = factors.get(term.name, 0.0) + factor
            else:
                constant += factor
        margin = Margin(tuple(sorted(factors.items())), constant, self.term)
        if margin not in self.margins:
            self.margins.append(margin)
        return nodes.Slot(self.margins.index(margin))


def _flatten(term: nodes.Term, factor: float) -> Parts:
    # ``factor`` times the term, as a sum.
    if not nodes.signals(term):
        return ((factor * _value(term), None),)
    match term:
        case nodes.Signal(arguments=()):
            return ((factor, term),)
        case nodes.Negative(operand):
            return _flatten(operand, -factor)
        case nodes.Arithmetic("+" | "-" as op, left, right):
            return _flatten(left, factor) + _flatten(right, factor if op == "+" else -factor)
        case nodes.Arithmetic("*", left, right) if not nodes.signals(left):
            return _flatten(right, factor * _value(left))
        case nodes.Arithmetic("*", left, right) if not nodes.signals(right):
            return _flatten(left, factor * _value(right))
        case nodes.Arithmetic("/", left, right) if not nodes.signals(right) and _value(right) != 0.0:
            return _flatten(left, factor / _value(right))
        case nodes.Call("abs" | "min" | "max"):
            return ((factor, term),)
    raise UsageError(
        f"the term `{to_text(term)}` is not affine in the signals",
        "exact slices need sums, differences and constant factors (and abs, min, max) of signals",
    )


def _value(term: nodes.Term) -> float:
    with np.errstate(all="ignore"):
        return float(compile_term(term, 1)({}))


def _conjuncts(node: nodes.Node, steps: int, closed: bool) -> list[Conjunct]:
    match node:
        case nodes.Connective("and", left, right):
            return _conjuncts(left, steps, closed) + _conjuncts(right, steps, closed)
        case nodes.Window("always", lo, hi, child) if _is_instant(child):
            samples = np.arange(lo, int(min(hi, steps)) + 1)
            return [_conjunct(child, samples[:, None], closed)] if len(samples) else []
        case _ if _is_instant(node):
            return [_conjunct(node, np.zeros((1, 1), dtype=np.int64), closed)]
    return [_conjunct(node, np.arange(steps + 1)[None], closed)]


def _conjunct(node: nodes.Node, windows: np.ndarray, closed: bool) -> Conjunct:
    used = tuple(sorted({part.index for part in nodes.walk(node) if isinstance(part, nodes.Slot)}))

    def renumber(part: nodes.Node) -> nodes.Node:
        return (
            nodes.Slot(used.index(part.index))
            if isinstance(part, nodes.Slot)
            else nodes.rebuild(part, renumber)
        )

    return Conjunct(renumber(node), used, windows, closed)


def _is_instant(node: nodes.Node) -> bool:
    return not any(isinstance(part, nodes.Window | nodes.Until | nodes.Step) for part in nodes.walk(node))
