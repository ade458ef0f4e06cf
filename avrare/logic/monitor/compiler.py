"""Compiler from a formula to a monitor plan: root folds and the nodes below them.

Nested unbounded future operators are carried by corner tables, so that every step costs the same. If that is
impossible, a root fold evaluates the complete history instead: with more than ``MAX_CORNERS`` of them in a
formula, or one below iff, xor or a quantifier that is itself below a temporal operator.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from avrare.logic.monitor.corner_tables import MAX_CORNERS
from avrare.logic.monitor.monitor_node import MonitorNode
from avrare.logic.monitor.operator_nodes import (
    FEW,
    ComparisonNode,
    ObligationNode,
    PointwiseNode,
    SinceNode,
    UnboundedPastNode,
    UnboundedSinceNode,
    UntilNode,
    make_window,
)
from avrare.logic.monitor.root_folds import HistoryFold, RootFold, UntilFold, WindowFold
from avrare.logic.semantics.normal_form import (
    find_obligations,
    find_truth_at_zero,
    is_unbounded_future,
    normalize,
    place_quantifiers,
)
from avrare.logic.semantics.trace_evaluator import connect, get_join, quantify
from avrare.logic.syntax import nodes
from avrare.logic.syntax.nodes import Node

_HUGE = 1e290
"""Magnitude that is too small to make the largest double overflow when it is added."""


@dataclass
class MonitorPlan:
    """Compiled formula.

    Attributes:
        skeleton: Connectives and quantifiers over ``Slot(k)``, the value of root fold k.
        folds: Root folds.
        nodes: Sub-formulas below the root folds, operands first.
        obligations: Unbounded future operators among them, by corner axis.
        horizon: Last sample that matters.
        settling: Samples after which values are constant once the signals are.
        reach: Samples that the nodes look ahead.
        trend: ``np.minimum`` if robustness can only fall over time, ``np.maximum`` if it can only rise; else
            None.
        body: Node of φ, for ``always φ`` with φ that does not look ahead; else None.
        quiet: True if no floating-point warning can arise: signals are only compared with numbers that are
            not huge, and there is no iff or xor.
        stepwise: True if nominal values come from a few open ones, without corners.
        at_zero: Truth of the formula where its robustness is 0; None if that varies.
    """

    skeleton: Node
    folds: list[RootFold] = field(default_factory=list)
    nodes: list[MonitorNode] = field(default_factory=list)
    obligations: list[ObligationNode] = field(default_factory=list)
    horizon: float = math.inf
    settling: int = 0
    reach: int = 0
    trend: np.ufunc | None = None
    body: MonitorNode | None = None
    quiet: bool = False
    stepwise: bool = False
    at_zero: bool | None = None


def compile_formula(formula: Node, closed: bool) -> MonitorPlan:
    """Compile a formula; if ``closed``, until and since need their left operand at the witness."""
    # 1. Normal form, cut into root folds and nodes.
    compiler = _Compiler(place_quantifiers(normalize(formula)), closed)
    plan = compiler.plan
    # 2. Properties that save work at every step.
    plan.horizon, plan.settling = nodes.horizon(formula), nodes.settling(compiler.root)
    plan.reach = max((node.delay for node in plan.nodes), default=0)
    plan.at_zero = find_truth_at_zero(compiler.root)
    plan.quiet = all(_is_quiet(part) for part in nodes.walk(formula))
    plan.stepwise = not plan.obligations and all(x.delay <= FEW or x.shrinking for x in plan.folds)
    root = plan.folds[0]
    if isinstance(plan.skeleton, nodes.Slot) and isinstance(root, WindowFold | UntilFold):
        if not (root.node.delay or root.node.depends):
            plan.trend = root.join
        if isinstance(root, WindowFold) and (plan.trend, root.lo, root.hi) == (np.minimum, 0, math.inf):
            plan.body = root.node
    return plan


class _Compiler:
    def __init__(self, root: Node, closed: bool) -> None:
        self.root, self.closed = root, closed
        self.plan = MonitorPlan(root)
        self._nodes: dict[Node, MonitorNode] = {}
        self._axes: dict[Node, int] = {}
        self.plan.skeleton = self._replace_temporal(root, self._collect_axes)
        self.plan.skeleton = self._replace_temporal(root, self._add_fold)

    def _replace_temporal(self, formula: Node, visit: Callable[[Node], Node]) -> Node:
        top = nodes.Not | nodes.Connective | nodes.Quantifier
        if isinstance(formula, top) and nodes.horizon(formula) > 0:
            return nodes.rebuild(formula, functools.partial(self._replace_temporal, visit=visit))
        return visit(formula)

    def _collect_axes(self, formula: Node) -> Node:
        if _fits_corners(formula):
            for part in _obligations_below(formula):
                self._axes.setdefault(part, len(self._axes))
        return formula

    def _add_fold(self, formula: Node) -> Node:
        self.plan.folds.append(self._make_fold(formula))
        return nodes.Slot(len(self.plan.folds) - 1)

    def _make_fold(self, formula: Node) -> RootFold:
        too_many = len(self._axes) > MAX_CORNERS and _obligations_below(formula)
        if not _fits_corners(formula) or too_many:
            return HistoryFold(formula, self.closed)
        match formula:
            case nodes.Window("always" | "eventually" as op, lo, hi, child):
                return WindowFold(get_join(op), lo, hi, self._node(child), self._shrinks(get_join(op), child))
            case nodes.Until("until" | "release" as op, lo, hi, left, right):
                return UntilFold(get_join(op), lo, hi, (self._node(left), self._node(right)), self.closed)
            case _:
                return WindowFold(np.minimum, 0, 0, self._node(formula))  # its value at sample 0

    def _node(self, formula: Node) -> MonitorNode:
        if formula not in self._nodes:
            children = [self._node(child) for child in nodes.children(formula)]
            self._nodes[formula] = self._add(self._make_node(formula, children))
        return self._nodes[formula]

    def _add(self, node: MonitorNode) -> MonitorNode:
        node.index = len(self.plan.nodes)
        self.plan.nodes.append(node)
        return node

    def _shrinks(self, join: np.ufunc, child: Node) -> bool:
        # The operand must be a future window of the other kind over a formula that does not look ahead.
        if not (isinstance(child, nodes.Window) and child.op in nodes.FUTURE and math.isfinite(child.hi)):
            return False
        return get_join(child.op) is not join and self._node(child.child).delay == 0

    def _make_node(self, formula: Node, children: list[MonitorNode]) -> MonitorNode:
        match formula:
            case nodes.Comparison():
                return ComparisonNode(formula)
            case nodes.Constant(value):
                margin = nodes.Number(math.inf if value else -math.inf)
                return ComparisonNode(nodes.Comparison(">", margin, nodes.Number(0.0)))
            case nodes.Not():
                return PointwiseNode(lambda x, algebra, lead: algebra.negate(x[0]), children)
            case nodes.Connective(op):
                return PointwiseNode(lambda x, algebra, lead: connect(op, x[0], x[1], algebra), children)
            case nodes.Quantifier():
                return PointwiseNode(lambda x, algebra, lead: quantify(formula, x[0], lead), children)
            case nodes.Window(op, lo, hi) | nodes.Until(op, lo, hi):
                return self._make_temporal(formula, op, lo, hi, children)
        raise TypeError(f"not a formula: {formula!r}")

    def _make_temporal(
        self, formula: Node, op: str, lo: int, hi: float, children: list[MonitorNode]
    ) -> MonitorNode:
        join, closed, past = get_join(op), self.closed, op in nodes.PAST
        single = len(children) == 1
        if is_unbounded_future(formula):
            obligation = ObligationNode(join, children, closed=closed)
            obligation.bind(self._axes[formula], len(self._axes))
            self.plan.obligations.append(obligation)
            self.plan.obligations.sort(key=lambda node: node.obligation or 0)
            return obligation
        if math.isinf(hi):
            unbounded = UnboundedPastNode if single else UnboundedSinceNode
            node = unbounded(join, children, past=True, closed=closed)
            node.keep = 1
            return node
        if single:
            *chain, last = make_window(join, lo, int(hi), children[0], past)
            for pair in chain:
                self._add(pair)
            return last
        return (SinceNode if past else UntilNode)(join, children, (lo, int(hi)), past=past, closed=closed)


def _is_quiet(part: Node | nodes.Term) -> bool:
    match part:
        case nodes.Comparison(_, nodes.Signal(), nodes.Number(value)) | nodes.Comparison(
            _, nodes.Number(value), nodes.Signal()
        ):
            return abs(value) < _HUGE
        case nodes.Predicate(term):
            return isinstance(term, nodes.Signal)
        case nodes.Comparison():
            return False
        case _:
            return not nodes.is_signless(part)


def _obligations_below(formula: Node) -> list[Node]:
    if isinstance(formula, nodes.Window | nodes.Until) and formula.op in nodes.FUTURE:
        below = (part for child in nodes.children(formula) for part in find_obligations(child))
        return list(dict.fromkeys(below))
    return find_obligations(formula)


def _fits_corners(formula: Node) -> bool:
    # Corner tables carry a formula whose value is monotone in few obligations.
    if len(_obligations_below(formula)) > MAX_CORNERS:
        return False
    return not any(
        find_obligations(part)
        for part in nodes.walk(formula)
        if isinstance(part, nodes.Not | nodes.Quantifier) or nodes.is_signless(part)
    )
