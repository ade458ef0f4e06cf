"""A formula cut into leaves and cells: what a monitor computes at every sample.

Nested unbounded future operators are carried by ``corners`` tables, so that a step costs the same at every
sample. Where that does not work, the leaf is evaluated anew on the whole history: more than ``MAX_CORNERS``
of them in a formula, or one below iff, xor or a quantifier that is itself below a temporal operator.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from avrare.logic import formula as f
from avrare.logic.cells import Atom, Cell, Joined, Negated, Quantified, Truth
from avrare.logic.corners import MAX_CORNERS
from avrare.logic.leaves import Fold, Leaf, Point, Race, Replay
from avrare.logic.normal import core, is_endless, obligations, place_quantifiers, truth_at_zero
from avrare.logic.robustness import joining
from avrare.logic.temporal import FEW, Obligation, PastFold, Since, SinceFold, Until, windowed

_HUGE = 1e290
"""Too small to make the largest double overflow when it is added."""


@dataclass
class Plan:
    """A formula cut into leaves.

    Attributes:
        skeleton: Connectives and quantifiers over ``Slot(k)``, the value of leaf k.
        leaves: The parts that change with time.
        cells: The sub-formulas below the leaves, operands first.
        obligations: The unbounded future operators among them, by corner axis.
        horizon: The last sample that matters.
        settling: Samples after which values repeat once the signals do.
        reach: Samples that the cells look ahead.
        trend: ``np.minimum`` if robustness can only fall as samples come, ``np.maximum`` if it can only rise;
            else None.
        body: For ``always φ``, φ looking only back: φ's cell, else None.
        quiet: Whether no floating-point warning can arise: signals are only compared with numbers that are
            not huge, and there is no iff or xor.
        stepwise: Whether nominal values come from a few open ones, without corners.
        at_zero: Whether the formula is true where its robustness is 0; None: that does not tell.
    """

    skeleton: f.Node
    leaves: list[Leaf] = field(default_factory=list)
    cells: list[Cell] = field(default_factory=list)
    obligations: list[Obligation] = field(default_factory=list)
    horizon: float = math.inf
    settling: int = 0
    reach: int = 0
    trend: np.ufunc | None = None
    body: Cell | None = None
    quiet: bool = False
    stepwise: bool = False
    at_zero: bool | None = None


def make_plan(node: f.Node, closed: bool) -> Plan:
    """The plan of a formula; ``closed`` is the reading of until and since."""
    builder = _Builder(place_quantifiers(core(node)), closed)
    plan = builder.plan
    plan.horizon, plan.settling = f.horizon(node), f.settling(builder.root)
    plan.reach = max((cell.delay for cell in plan.cells), default=0)
    plan.at_zero = truth_at_zero(builder.root)
    plan.quiet = all(_is_quiet(part) for part in f.walk(node))
    plan.stepwise = not plan.obligations and all(x.delay <= FEW or x.shrinking for x in plan.leaves)
    root = plan.leaves[0]
    if isinstance(plan.skeleton, f.Slot) and isinstance(root, Fold | Race):
        if not (root.cell.delay or root.cell.depends):
            plan.trend = root.join
        if isinstance(root, Fold) and (plan.trend, root.lo, root.hi) == (np.minimum, 0, math.inf):
            plan.body = root.cell
    return plan


class _Builder:
    def __init__(self, root: f.Node, closed: bool) -> None:
        self.root, self.closed = root, closed
        self.cells: dict[f.Node, Cell] = {}
        self.plan = Plan(root)
        self.axes: dict[f.Node, int] = {}
        self.plan.skeleton = self._cut(root, self._collect)
        self.plan.skeleton = self._cut(root, self._leaf)

    def _cut(self, node: f.Node, visit: Callable[[f.Node], f.Node]) -> f.Node:
        """The formula with its leaves visited."""
        if isinstance(node, f.Not | f.Connective | f.Quantifier) and f.horizon(node) > 0:
            return f.rebuild(node, functools.partial(self._cut, visit=visit))
        return visit(node)

    def _collect(self, node: f.Node) -> f.Node:
        if _fits(node):
            for part in _below(node):
                self.axes.setdefault(part, len(self.axes))
        return node

    def _leaf(self, node: f.Node) -> f.Node:
        self.plan.leaves.append(self._make(node))
        return f.Slot(len(self.plan.leaves) - 1)

    def _make(self, node: f.Node) -> Leaf:
        if not _fits(node) or (len(self.axes) > MAX_CORNERS and _below(node)):
            return Replay(node, self.closed)
        match node:
            case f.Window("always" | "eventually" as op, lo, hi, child):
                return Fold(joining(op), lo, hi, self._cell(child), self._shrinks(joining(op), child))
            case f.Until("until" | "release" as op, lo, hi, left, right):
                return Race(joining(op), lo, hi, (self._cell(left), self._cell(right)), self.closed)
            case _:
                return Point(self._cell(node))

    def _cell(self, node: f.Node) -> Cell:
        if node not in self.cells:
            self.cells[node] = self._add(self._new(node, [self._cell(child) for child in f.children(node)]))
        return self.cells[node]

    def _add(self, cell: Cell) -> Cell:
        cell.index = len(self.plan.cells)
        self.plan.cells.append(cell)
        return cell

    def _shrinks(self, join: np.ufunc, child: f.Node) -> bool:
        """Whether a leaf's operand is a window ahead, of the other kind, over what does not look ahead."""
        if not (isinstance(child, f.Window) and child.op in f.FUTURE and math.isfinite(child.hi)):
            return False
        return joining(child.op) is not join and self._cell(child.child).delay == 0

    def _new(self, node: f.Node, children: list[Cell]) -> Cell:
        match node:
            case f.Comparison():
                return Atom(node)
            case f.Constant(value):
                return Truth(math.inf if value else -math.inf)
            case f.Connective(op):
                return Joined(op, *children)
            case f.Not():
                return Negated(*children)
            case f.Quantifier():
                return Quantified(node, *children)
            case f.Window(op, lo, hi) | f.Until(op, lo, hi):
                return self._temporal(node, op, lo, hi, children)
        raise TypeError(f"not a formula: {node!r}")

    def _temporal(self, node: f.Node, op: str, lo: int, hi: float, children: list[Cell]) -> Cell:
        join, closed, past = joining(op), self.closed, op in f.PAST
        single = len(children) == 1
        if is_endless(node):
            obligation = Obligation(join, children, closed=closed)
            obligation.bind(self.axes[node], len(self.axes))
            self.plan.obligations.append(obligation)
            self.plan.obligations.sort(key=lambda cell: cell.obligation or 0)
            return obligation
        if math.isinf(hi):
            cell = (PastFold if single else SinceFold)(join, children, past=True, closed=closed)
            cell.keep = 1
            return cell
        if single:
            *chain, last = windowed(join, lo, int(hi), children[0], past)
            for pair in chain:
                self._add(pair)
            return last
        return (Since if past else Until)(join, children, (lo, int(hi)), past=past, closed=closed)


def _is_quiet(part: f.Node | f.Term) -> bool:
    match part:
        case f.Comparison(_, f.Signal(), f.Number(value)) | f.Comparison(_, f.Number(value), f.Signal()):
            return abs(value) < _HUGE
        case f.Predicate(term):
            return isinstance(term, f.Signal)
        case f.Comparison():
            return False
        case _:
            return not (isinstance(part, f.Connective) and part.op in ("iff", "xor"))


def _below(leaf: f.Node) -> list[f.Node]:
    """The unbounded future operators below a leaf's own operator."""
    if isinstance(leaf, f.Window | f.Until) and leaf.op in f.FUTURE:
        return list(dict.fromkeys(part for child in f.children(leaf) for part in obligations(child)))
    return obligations(leaf)


def _fits(leaf: f.Node) -> bool:
    """Whether tables over corners can carry the leaf."""
    if len(_below(leaf)) > MAX_CORNERS:
        return False
    return not any(
        obligations(part)
        for part in f.walk(leaf)
        if isinstance(part, f.Not | f.Quantifier)
        or (isinstance(part, f.Connective) and part.op in ("iff", "xor"))
    )
