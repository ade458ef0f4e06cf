"""Monitor plan of a formula: its root folds, and the nodes below them.

Nested unbounded future operators are carried by corner tables, so that every step costs the same. If that is
impossible, their values stay open, and those of their operands are kept for the complete history: beyond
``MAX_CORNERS`` of them, and below iff, xor, or a quantifier that is itself below a temporal operator.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from avrare.logic.monitor.monitor_nodes import (
    NEVER,
    ComparisonNode,
    MonitorNode,
    ObligationNode,
    PairNode,
    PastNode,
    SampleContext,
    UntilNode,
    compose,
)
from avrare.logic.monitor.open_samples import OpenSamples, UnseenSamples
from avrare.logic.semantics.normal_form import find_truth_at_zero, normalise, place_quantifiers
from avrare.logic.semantics.trace_evaluator import Evaluator, align, get_join, require_scalar
from avrare.logic.semantics.value_algebra import RobustnessAlgebra, SignedAlgebra
from avrare.logic.semantics.window_operators import Array, get_neutral
from avrare.logic.syntax import nodes
from avrare.logic.syntax.nodes import Node

MAX_CORNERS = 4
"""Unbounded future operators n in a table, at most: a step costs up to 4^n operations per particle."""
Carry = tuple[tuple[Array, ...], ...]
"""Values (N, ...) of each node that are still needed, oldest first."""
FEW = 64
"""Open values up to which monitors without corners compute them one by one."""


class RootFold(MonitorNode):
    """Value of a sub-formula at sample 0: that of its node at the samples ``lo .. hi`` joined by ``join``."""

    def __init__(self, node: MonitorNode, join: np.ufunc, lo: int, hi: float) -> None:
        super().__init__(node.formula, [node])
        self.node, self.join, self.lo, self.hi = node, join, lo, hi
        self.delay += lo
        self.keep = 1
        window = node if isinstance(node, PairNode) and node.clipped and node.join is not join else None
        self._shrinks = window is not None and not window.operands[0].delay

    def settle(self, now: SampleContext) -> Array:
        """Return the value of the settled samples."""
        settled, newest = now.tables[self.index], now.tables[self.node.index][-1]
        if not settled:
            return newest
        return self.join(settled[-1], newest) if now.t - self.node.delay <= self.hi else settled[-1]

    def add_nominal(self, now: SampleContext) -> Array:
        """Return the value (N, ...) with the open samples of the trace as it is, without corners."""
        settled = now.tables[self.index][-1:]
        if settled and not self.node.delay:
            return settled[0]
        first, last = max(self.lo, now.t - self.node.delay + 1), int(min(self.hi, now.t))
        samples = range(last, first - 1, -1)
        if self._shrinks and len(samples) > 1:  # the smallest window decides; the largest may have NaN
            samples = samples[:1] if settled else samples[:: len(samples) - 1]
        values = [now.at(self.node, i) for i in samples]
        if settled or values:
            return functools.reduce(self.join, values, *settled)
        return np.full_like(now.at(self.node, now.t), get_neutral(self.join))

    def add_open(self, samples: OpenSamples, now: SampleContext) -> Array:
        """Return the value with the open samples, (N, ...) or as bounds (2, N, ...)."""
        settled = [samples.collapse(table) for table in now.tables[self.index][-1:]]
        if settled and not samples.count(self.node):
            return settled[0]
        value = samples.reduce(self.node, self.join, self.lo, self.hi)
        return np.asarray(self.join(*align(settled[0], value))) if settled else value


class MonitorPlan:
    """Compiled formula, which settles its nodes at each sample.

    One pass gives robustness and truth, except under iff and xor, which need a pass for each.

    Args:
        formula: Formula.
        closed: True if until and since need their left operand at the witness.
        plain: True to keep margins of 0 where all of them are true, or none.

    Attributes:
        algebras: Algebra of robustness, and of truth if the signs of the margins do not tell it.
        is_false: ``is_false(value, 0)`` is where the formula is false.
        horizon: Last sample that matters.
        falling: True if robustness never rises over time.
        body: Node of φ, for ``always φ`` with φ that does not look ahead; else None.
    """

    def __init__(self, formula: Node, closed: bool, plain: bool = False) -> None:
        # 1. Normal form, cut into a skeleton of connectives and quantifiers over ``Slot(k)``, the value of
        #    root fold k, and nodes, operands first; obligations are in the order of their corner axes.
        normal = place_quantifiers(normalise(formula))
        self._closed = closed
        self._nodes: dict[Node, MonitorNode] = {}
        self._order: list[MonitorNode] = []
        self._obligations: list[MonitorNode] = []
        roots: list[Node] = []
        self._skeleton = _cut_temporal(normal, roots)
        roots = [_window_from_start(root, closed) for root in roots]
        self._entangled = {part for root in roots for part in _find_entangled(root)}
        self._folds = [self._make_fold(root) for root in roots]
        # 2. Algebras.
        at_zero = find_truth_at_zero(normal) if plain else None
        only = SignedAlgebra() if at_zero is None else RobustnessAlgebra()
        signless = any(map(nodes.is_signless, nodes.walk(formula)))
        self.algebras = (RobustnessAlgebra(), SignedAlgebra()) if signless else (only,)
        self.is_false = np.less_equal if at_zero is False else np.less
        # 3. Properties that save work at every step.
        self.horizon = nodes.horizon(formula)
        bodies, root = [fold.formula for fold in self._folds], self._folds[0]
        self._settling, self._reach = max(map(nodes.settling, bodies)), max(map(nodes.bounded_span, bodies))
        delay = max(fold.node.delay for fold in self._folds)
        self._stepwise = delay <= FEW and not self._obligations
        self._single = isinstance(self._skeleton, nodes.Slot)
        self.falling = root.join is np.minimum and self._single and not delay and not self._obligations
        self.body = root.node if self.falling and (root.lo, root.hi) == (0, math.inf) else None
        self._steps = [
            (
                node.delay,
                slice(-node.keep, None) if node.keep else slice(0),
                functools.partial(_compose, node) if self._obligations else node.settle,
            )
            for node in self._order
        ]

    def start(self) -> tuple[Carry, ...]:
        """Return what is carried before sample 0, for each algebra."""
        return (((),) * len(self._order),) * len(self.algebras)

    def lay_out_rest(self, seen: int, length: int | None) -> UnseenSamples:
        """Lay out the samples after ``seen`` ones of a trace of ``length`` samples (None: endless)."""
        return UnseenSamples.of(seen, self._settling, self._reach, length)

    def advance(
        self,
        carried: tuple[Carry, ...],
        sample: Mapping[str, Array],
        t: int,
        rows: int,
        unseen: UnseenSamples | None = None,
    ) -> tuple[tuple[Carry, ...], list[Array], tuple[Array, ...]]:
        """Settle sample ``t``; return the carry, and the formula's and the body's value in each algebra."""
        n, carries, values, newest = len(self._obligations), [], [], []
        for algebra, before in zip(self.algebras, carried, strict=True):
            # 1. Settle all nodes, operands first, with the corners in front of the particles.
            tables = list(_move_rows(before, 0, n) if n else before)
            now = SampleContext(t, rows, sample, algebra, self._closed, tables, [None] * n)
            kept = []
            for k, (delay, tail, settle) in enumerate(self._steps):
                if t >= delay:
                    value = settle(now)  # may replace the table
                    tables[k] += (value,)
                kept.append(tables[k][tail])
            carries.append(_move_rows(kept, n, 0) if n else tuple(kept))
            # 2. Add the open samples.
            values.append(self._value(now, unseen))
            if self.body:
                newest.append(tables[self.body.index][-1])
        return tuple(carries), values, tuple(newest)

    def _value(self, now: SampleContext, unseen: UnseenSamples | None) -> Array:
        # The nominal value (N,), or its bounds (2, N) over all unseen samples.
        # 1. Values of the root folds.
        algebra = now.algebra
        if unseen is None and self._stepwise:
            values = [fold.add_nominal(now) for fold in self._folds]
        else:
            samples = OpenSamples(now, self._obligations, unseen)
            algebra = samples.algebra
            values = [fold.add_open(samples, now) for fold in self._folds]
        # 2. Connectives and quantifiers above them.
        value = values[0]
        if not self._single:
            slots = [value[None] for value in values]
            value = Evaluator({}, 1, now.rows, algebra, self._closed, slots)(self._skeleton)[0]
        # 3. One value per particle.
        shape = (2, now.rows) if unseen else (now.rows,)
        if value.shape == shape:
            return value
        require_scalar(value.ndim - len(shape))
        return np.broadcast_to(value, shape)

    def _make_fold(self, formula: Node) -> RootFold:
        join, lo, hi = get_join("always"), 0, 0.0  # by default its value at sample 0
        if isinstance(formula, nodes.Window) and formula.op in nodes.FUTURE:
            join, lo, hi, formula = get_join(formula.op), formula.lo, formula.hi, formula.child
        fold = RootFold(self._node(formula), join, lo, hi)
        self._add(fold)
        return fold

    def _node(self, formula: Node) -> MonitorNode:
        if formula not in self._nodes:
            self._nodes[formula] = self._make_node(formula)
        return self._nodes[formula]

    def _make_node(self, formula: Node) -> MonitorNode:
        operands = [self._node(child) for child in nodes.children(formula)]
        match formula:
            case nodes.Constant(value):
                margin = nodes.Number(math.inf if value else -math.inf)
                return self._add(ComparisonNode(nodes.Comparison(">", margin, nodes.Number(0.0))))
            case nodes.Comparison():
                return self._add(ComparisonNode(formula))
            case nodes.Window(op, _, math.inf) | nodes.Until(op, _, math.inf) if op in nodes.PAST:
                return self._add(PastNode(formula, operands))
            case nodes.Window(hi=math.inf) | nodes.Until(hi=math.inf):
                return self._add(self._make_obligation(formula, operands))
            case nodes.Window():
                return self._make_window(formula, operands[0])
            case nodes.Until(hi=hi):
                return self._add(UntilNode(formula, operands, int(hi)))
        return self._add(MonitorNode(formula, operands))

    def _make_obligation(
        self, formula: nodes.Window | nodes.Until, operands: list[MonitorNode]
    ) -> MonitorNode:
        settled = all(node.delay < NEVER for node in operands)
        fits = settled and formula not in self._entangled and len(self._obligations) < MAX_CORNERS
        node = ObligationNode(formula, operands, len(self._obligations) if fits else None)
        if fits:
            self._obligations.append(node)
        return node

    def _make_window(self, formula: nodes.Window, base: MonitorNode) -> MonitorNode:
        # The width doubles from pair to pair; only the last one has the window's offset.
        sign, lo, width = -1 if formula.op in nodes.PAST else 1, formula.lo, int(formula.hi) - formula.lo + 1
        half, covered = base, 1
        while 2 * covered < width:
            half = self._add(PairNode(formula, half, 0, sign * covered))
            covered *= 2
        return self._add(PairNode(formula, half, sign * lo, sign * (lo + width - covered), base))

    def _add(self, node: MonitorNode) -> MonitorNode:
        node.index = len(self._order)
        self._order.append(node)
        return node


def _compose(node: MonitorNode, now: SampleContext) -> Array:
    # An obligation's own value converts all tables, its own among them.
    value = None
    if node.axis is not None:
        value = now.values[node.axis] = node.settle(now)
    now.tables[node.index] = tuple([compose(table, now.values) for table in now.tables[node.index]])
    return node.settle(now) if value is None else value


def _move_rows(carry: Iterable[tuple[Array, ...]], axis: int, to: int) -> Carry:
    # (N, corners, ...) to (corners, N, ...) or back.
    return tuple([tuple([_move(x, axis, to) for x in table]) for table in carry])


def _move(x: Array, axis: int, to: int) -> Array:
    axes = list(range(x.ndim))  # faster than np.moveaxis
    axes.insert(to, axes.pop(axis))
    return x.transpose(axes)


def _cut_temporal(formula: Node, roots: list[Node]) -> Node:
    top = nodes.Not | nodes.Connective | nodes.Quantifier
    if isinstance(formula, top) and nodes.horizon(formula) > 0:
        return nodes.rebuild(formula, functools.partial(_cut_temporal, roots=roots))
    roots.append(formula)
    return nodes.Slot(len(roots) - 1)


def _find_entangled(formula: Node) -> Iterator[Node | nodes.Term]:
    # A table cannot carry what the value is not monotone in.
    for part in nodes.walk(formula):
        if isinstance(part, nodes.Not | nodes.Quantifier) or nodes.is_signless(part):
            yield from nodes.walk(part)


def _window_from_start(formula: Node, closed: bool) -> Node:
    # At sample 0, φ until ψ is: eventually ψ and, so far, historically φ.
    match formula:
        case nodes.Until("until" | "release" as op, lo, hi, left, right):
            hold, reach, both = (
                ("historically", "eventually", "and") if op == "until" else ("once", "always", "or")
            )
            held: Node = nodes.Window(hold, 0, math.inf, left)
            if not closed:
                held = nodes.Window(hold, 1, 1, held)
            return nodes.Window(reach, lo, hi, nodes.Connective(both, right, held))
    return formula
