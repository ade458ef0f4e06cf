"""A formula as minima and maxima of affine margins: what can be solved in closed form.

In negation normal form a formula's robustness is below c exactly if the formula is violated once c is taken
off all its margins. That, and where each margin alone changes sign, is all that a slice needs to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from avrare.errors import UsageError
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.api import Formula
from avrare.logic.normal import core
from avrare.logic.printing import text
from avrare.logic.robustness import Evaluator
from avrare.logic.terms import reader
from avrare.protocols import Floats

Parts = tuple[tuple[float, f.Term | None], ...]
"""A sum: factors with signals or min, max, abs; None is the constant 1."""


@dataclass(frozen=True)
class Margin:
    """factors x signals + constant, positive where the predicate holds.

    Attributes:
        factors: By name of the signal.
        constant: Added.
    """

    factors: tuple[tuple[str, float], ...]
    constant: float


@dataclass(frozen=True)
class Conjunct:
    """A part of a conjunction over time: it must hold in each of Q windows.

    Attributes:
        node: In negation normal form; ``Slot(i)`` stands for margin ``used[i]``.
        used: Indices of its J margins.
        windows: (Q, W) samples that each evaluation sees; it counts at the first.
        closed: The reading of until.
    """

    node: f.Node
    used: tuple[int, ...]
    windows: np.ndarray
    closed: bool

    def violated(self, margins: Floats) -> np.ndarray:
        """(rows,) from margins (J, W, rows)."""
        steps, rows = margins.shape[1:]
        slots = [np.ascontiguousarray(margin) for margin in margins]
        value = Evaluator({}, steps, rows, Robustness(), self.closed, slots)(self.node)
        return np.asarray(value[0] < 0.0)


@dataclass(frozen=True)
class AffineFormula:
    """A formula with affine predicates.

    Attributes:
        node: The formula in negation normal form over ``Slot(index)`` of the margins.
        margins: Of its predicates.
        closed: The reading of until.
    """

    node: f.Node
    margins: tuple[Margin, ...]
    closed: bool

    @staticmethod
    def of(formula: Formula) -> AffineFormula:
        """The formula's own.

        Raises:
            UsageError: A term is not affine (sums, differences, constant factors, and abs, min, max of such),
                or it has iff, xor or quantifiers.
        """
        reading = _Reading()
        return AffineFormula(reading.node(core(formula.node)), tuple(reading.margins), formula.closed)

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signals read."""
        return tuple(dict.fromkeys(name for margin in self.margins for name, _ in margin.factors))

    def conjuncts(self, steps: int) -> list[Conjunct]:
        """What must hold, all of it, for the formula to hold at sample 0 of samples 0..steps."""
        return list(_conjuncts(self.node, steps, self.closed))

    def combine(self, names: Sequence[str], values: Floats, constant: bool = True) -> Floats:
        """Margins (..., P) from the signals ``names`` (..., n)."""
        out = np.zeros((*values.shape[:-1], len(self.margins)))
        for k, margin in enumerate(self.margins):
            for name, factor in margin.factors:
                out[..., k] += factor * values[..., names.index(name)]
            out[..., k] += margin.constant if constant else 0.0
        return out


class _Reading:
    """Collects the margins of a formula's comparisons."""

    def __init__(self) -> None:
        self.margins: list[Margin] = []

    def node(self, node: f.Node) -> f.Node:
        """The formula with comparisons replaced by slots."""
        match node:
            case f.Comparison(op, left, right):
                above, below = (
                    _flatten(left, 1.0) + _flatten(right, -1.0),
                    _flatten(right, 1.0) + _flatten(left, -1.0),
                )
                if op in ("==", "!="):
                    return f.Connective(
                        "and" if op == "==" else "or", self.lattice(above), self.lattice(below)
                    )
                return self.lattice(above if op in (">", ">=") else below)
            case f.Connective("iff" | "xor" as op):
                raise UsageError(f"exact slices cannot be had of {op}", "write it with and, or, not")
            case f.Quantifier() | f.Not():
                raise UsageError("exact slices cannot be had of quantifiers", "write the vehicles out")
            case _:
                return f.rebuild(node, self.node)

    def lattice(self, parts: Parts) -> f.Node:
        """A sum as minima and maxima of affine margins."""
        for k, (factor, term) in enumerate(parts):
            if isinstance(term, f.Call):
                (first, *_) = arguments = term.arguments
                choices = (first, f.Negative(first)) if term.function == "abs" else arguments
                upper = (term.function != "min") == (factor > 0.0)
                nodes = [self.lattice((*parts[:k], *_flatten(c, factor), *parts[k + 1 :])) for c in choices]
                return reduce(lambda a, b: f.Connective("or" if upper else "and", a, b), nodes)
        return self.slot(parts)

    def slot(self, parts: Parts) -> f.Node:
        """The margin's place; equal ones share it."""
        factors: dict[str, float] = {}
        constant = 0.0
        for factor, term in parts:
            if isinstance(term, f.Signal):
                factors[term.name] = factors.get(term.name, 0.0) + factor
            else:
                constant += factor
        margin = Margin(tuple(sorted(factors.items())), constant)
        if margin not in self.margins:
            self.margins.append(margin)
        return f.Slot(self.margins.index(margin))


def _flatten(term: f.Term, factor: float) -> Parts:
    """``factor`` times a term as a sum."""
    if not f.signals(term):
        return ((factor * _value(term), None),)
    match term:
        case f.Signal(arguments=()):
            return ((factor, term),)
        case f.Negative(operand):
            return _flatten(operand, -factor)
        case f.Arithmetic("+" | "-" as op, left, right):
            return _flatten(left, factor) + _flatten(right, factor if op == "+" else -factor)
        case f.Arithmetic("*", left, right) if not f.signals(left):
            return _flatten(right, factor * _value(left))
        case f.Arithmetic("*", left, right) if not f.signals(right):
            return _flatten(left, factor * _value(right))
        case f.Arithmetic("/", left, right) if not f.signals(right) and _value(right) != 0.0:
            return _flatten(left, factor / _value(right))
        case f.Call("abs" | "min" | "max"):
            return ((factor, term),)
    raise UsageError(
        f"the term `{text(term)}` is not affine in the signals",
        "exact slices need sums, differences and constant factors (and abs, min, max) of signals",
    )


def _value(term: f.Term) -> float:
    with np.errstate(all="ignore"):
        return float(reader(term, 1)({}))


def _conjuncts(node: f.Node, steps: int, closed: bool) -> list[Conjunct]:
    match node:
        case f.Connective("and", left, right):
            return _conjuncts(left, steps, closed) + _conjuncts(right, steps, closed)
        case f.Window("always", lo, hi, child) if _is_instant(child):
            samples = np.arange(lo, int(min(hi, steps)) + 1)
            return [_conjunct(child, samples[:, None], closed)] if len(samples) else []
        case _ if _is_instant(node):
            return [_conjunct(node, np.zeros((1, 1), dtype=np.int64), closed)]
    return [_conjunct(node, np.arange(steps + 1)[None], closed)]


def _conjunct(node: f.Node, windows: np.ndarray, closed: bool) -> Conjunct:
    used = tuple(sorted({part.index for part in f.walk(node) if isinstance(part, f.Slot)}))

    def renumber(part: f.Node) -> f.Node:
        return f.Slot(used.index(part.index)) if isinstance(part, f.Slot) else f.rebuild(part, renumber)

    return Conjunct(renumber(node), used, windows, closed)


def _is_instant(node: f.Node) -> bool:
    """Whether the formula looks at one sample only."""
    return not any(isinstance(part, f.Window | f.Until | f.Step) for part in f.walk(node))
