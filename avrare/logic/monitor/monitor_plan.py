"""Monitor plan of a formula: its root folds, and the nodes below them.

Nested unbounded future operators are carried by corner tables, so that every step costs the same. If that is
impossible, a root fold evaluates the complete history instead: with more than ``MAX_CORNERS`` of them in a
formula, or one below iff, xor or a quantifier that is itself below a temporal operator.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from avrare.logic.monitor.monitor_node import (
    MAX_CORNERS,
    MonitorNode,
    OpenSamples,
    SampleContext,
    broadcast,
    compose,
    join_rows,
)
from avrare.logic.monitor.operator_nodes import FEW, make_nodes
from avrare.logic.semantics.normal_form import (
    find_obligations,
    find_truth_at_zero,
    normalise,
    place_quantifiers,
)
from avrare.logic.semantics.trace_evaluator import Evaluator, align, get_join
from avrare.logic.semantics.value_algebra import IntervalAlgebra, RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, accumulate, get_dual, get_neutral
from avrare.logic.syntax import nodes
from avrare.logic.syntax.nodes import Node

FoldCarry = tuple[Array, ...]


class MonitorPlan:
    """Compiled formula.

    Args:
        formula: Formula.
        closed: True if until and since need their left operand at the witness.

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
            not huge, without iff and xor.
        stepwise: True if nominal values come from a few open ones, without corners.
        at_zero: Truth of the formula where its robustness is 0; None if that varies.
    """

    def __init__(self, formula: Node, closed: bool) -> None:
        # 1. Normal form, cut into root folds and nodes.
        self._closed = closed
        self._nodes: dict[Node, MonitorNode] = {}
        self._axes: dict[Node, int] = {}
        self.nodes: list[MonitorNode] = []
        self.folds: list[RootFold] = []
        normal = place_quantifiers(normalise(formula))
        _replace_temporal(normal, self._collect_axes)
        self.skeleton = _replace_temporal(normal, self._add_fold)
        axes = {node.obligation: node for node in self.nodes if node.obligation is not None}
        self.obligations = [axes[axis] for axis in sorted(axes)]
        # 2. Properties that save work at every step.
        self.horizon, self.settling = nodes.horizon(formula), nodes.settling(normal)
        self.reach = max((node.delay for node in self.nodes), default=0)
        self.at_zero = find_truth_at_zero(normal)
        self.quiet = all(_is_quiet(part) for part in nodes.walk(formula))
        self.stepwise = not axes and all(x.node.delay <= FEW or x.shrinking for x in self.folds)
        root = self.folds[0]
        steady = isinstance(self.skeleton, nodes.Slot) and not isinstance(root, _HistoryFold)
        settled = not (root.node.delay or root.node.depends)
        self.trend = root.join if steady and settled else None
        entire = isinstance(root, _WindowFold) and (root.lo, root.hi) == (0, math.inf)
        self.body = root.node if entire and self.trend is np.minimum else None

    def _collect_axes(self, formula: Node) -> Node:
        if _fits_corners(formula):
            for part in _obligations_below(formula):
                self._axes.setdefault(part, len(self._axes))
        return formula

    def _add_fold(self, formula: Node) -> Node:
        self.folds.append(self._make_fold(formula))
        return nodes.Slot(len(self.folds) - 1)

    def _make_fold(self, formula: Node) -> RootFold:
        too_many = len(self._axes) > MAX_CORNERS and _obligations_below(formula)
        if not _fits_corners(formula) or too_many:
            return _HistoryFold(formula, self._closed)
        match formula:
            case nodes.Window("always" | "eventually" as op, lo, hi, child):
                fold = _WindowFold(self._node(child), get_join(op), lo, hi)
                fold.shrinking = self._shrinks(fold.join, child)
                return fold
            case nodes.Until("until" | "release" as op, lo, hi, left, right):
                operands = self._node(left), self._node(right)
                return _UntilFold(operands, get_join(op), lo, hi, self._closed)
            case _:
                return _WindowFold(self._node(formula), hi=0)  # its value at sample 0

    def _node(self, formula: Node) -> MonitorNode:
        if formula not in self._nodes:
            children = [self._node(child) for child in nodes.children(formula)]
            for node in make_nodes(formula, children, self._closed, self._axes):
                node.index = len(self.nodes)
                self.nodes.append(node)
            self._nodes[formula] = node
        return self._nodes[formula]

    def _shrinks(self, join: np.ufunc, child: Node) -> bool:
        # The operand must be a future window of the other kind over a formula that does not look ahead.
        if not (isinstance(child, nodes.Window) and child.op in nodes.FUTURE and math.isfinite(child.hi)):
            return False
        return get_join(child.op) is not join and self._node(child.child).delay == 0


def _replace_temporal(formula: Node, visit: Callable[[Node], Node]) -> Node:
    top = nodes.Not | nodes.Connective | nodes.Quantifier
    if isinstance(formula, top) and nodes.horizon(formula) > 0:
        return nodes.rebuild(formula, functools.partial(_replace_temporal, visit=visit))
    return visit(formula)


def _is_quiet(part: Node | nodes.Term) -> bool:
    match part:
        case nodes.Comparison(_, nodes.Signal(), nodes.Number(value)) | nodes.Comparison(
            _, nodes.Number(value), nodes.Signal()
        ):
            return abs(value) < 1e290  # too small to make the largest double overflow when it is added
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


class RootFold:
    """Sub-formula at sample 0.

    A fold joins the settled values of its node, sample by sample, into its carry of tables (corners, N, ...).
    Its present value joins the open ones too; with corners or bounds all at once.

    Args:
        node: Node whose settled values are folded.
        join: ``np.minimum`` or ``np.maximum``.
        lo: First sample that matters.
        hi: Last sample that matters; may be infinite.

    Attributes:
        shrinking: True if one or two of the open values determine the result.
    """

    shrinking = False

    def __init__(
        self, node: MonitorNode, join: np.ufunc = np.minimum, lo: int = 0, hi: float = math.inf
    ) -> None:
        self.node, self.join, self.lo, self.hi = node, join, lo, hi

    def settle(self, now: SampleContext, carry: FoldCarry) -> FoldCarry:
        """Return the carry after one more sample; empty before anything is settled."""
        if self.node.depends:
            carry = tuple(compose(x, now.values, 0) for x in carry)
        i = now.t - self.node.delay
        return self.step(now, carry, i) if i >= 0 else carry

    def open_samples(self, t: int) -> Sequence[int]:
        """Return the open samples up to ``t`` that matter."""
        return range(max(0, t - self.node.delay + 1), t + 1)

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        """Return the carry with sample ``i`` folded in."""
        raise NotImplementedError

    def result(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the value (N, ...) of all samples carried, without corners; neutral if there are none."""
        return carry[-1] if carry else np.full_like(now.at(self.node, now.t), get_neutral(self.join))

    def nominal(self, now: SampleContext, carry: FoldCarry) -> Array:
        """Return the nominal value (N, ...), without corners."""
        for i in self.open_samples(now.t) if self.node.delay else ():
            carry = self.step(now, carry, i)
        return self.result(now, carry)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        """Return the value, (N, ...) or as bounds (2, N, ...)."""
        raise NotImplementedError


class _WindowFold(RootFold):
    """always or eventually: running extremum of the settled values, joined with the open ones.

    Its values shrink if the open ones are extrema of the other kind, each over a later part of the samples of
    the one before, and the first over a part of those of the last settled one. The last one then decides; as
    long as nothing is settled, the first one is needed to find NaN.
    """

    def open_samples(self, t: int) -> Sequence[int]:
        settled = t - self.node.delay
        samples = range(max(self.lo, settled + 1), int(min(self.hi, t)) + 1)
        if not self.shrinking or len(samples) < 2:
            return samples
        return samples[-1:] if settled >= self.lo else samples[:: len(samples) - 1]

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        if not self.lo <= i <= self.hi:
            return carry
        value = now.at(self.node, i)
        return (self.join(carry[0], value),) if carry else (value,)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        node, start = self.node, samples.start(self.node)
        x: Any = ()
        if samples.count(node):
            x = samples.open(node)[samples.within(start, self.lo, self.hi)]
        if not carry and not len(x):
            return np.full_like(samples.rows(node, max(0, start - 1))[0], get_neutral(self.join))
        values = [samples.collapse(carry[0], node)] if carry else []
        if len(x):
            values.append(np.asarray(x[0] if len(x) == 1 else self.join.reduce(x, axis=0)))
        return values[0] if len(values) == 1 else np.asarray(self.join(*align(*values)))


class _UntilFold(RootFold):
    """until: margin by which the left operand has held, and the best witness; dually release."""

    def __init__(
        self, operands: Sequence[MonitorNode], join: np.ufunc, lo: int, hi: float, closed: bool
    ) -> None:
        super().__init__(MonitorNode(operands), join, lo, hi)
        self.closed = closed
        self.left, self.right = operands

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        if i > self.hi:
            return carry
        left, right = broadcast(now.at(self.left, i), now.at(self.right, i))
        join, meet = self.join, get_dual(self.join)
        before, best = carry or (np.full_like(left, get_neutral(meet)), np.full_like(left, get_neutral(join)))
        held = meet(before, left)
        if i >= self.lo:
            best = join(best, meet(right, held if self.closed else before))
        return held, best

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        # 1. The settled witnesses.
        before, best = (None, None) if not carry else (samples.collapse(x, self.node) for x in carry)
        if best is not None and not samples.count(self.node):
            return best
        # 2. The margin by which the left operand has held before each open sample.
        first, meet = samples.start(self.node), get_dual(self.join)
        left, right = broadcast(samples.rows(self.left, first), samples.rows(self.right, first))
        if before is None:
            before = np.full_like(left[0], get_neutral(meet))
        held = accumulate(meet, join_rows(before[None], left))
        # 3. The open witnesses inside the window.
        allowed = samples.within(first, self.lo, self.hi)
        witnesses = meet(right[allowed], self._held_until_witness(samples, held)[allowed])
        open_best = np.asarray(self.join.reduce(witnesses, axis=0, initial=get_neutral(self.join)))
        return open_best if best is None else np.asarray(self.join(best, open_best))

    def _held_until_witness(self, samples: OpenSamples, held: Array) -> Array:
        # The left operand's margin before each row's first sample in the window; including it if closed.
        if self.closed:
            return held[1:]
        common = samples.common_row(self.lo)
        if common is not None:  # the earlier samples of this row need the left operand too
            row = common - samples.start(self.node)
            held[row] = held[row + 1]
        return held[:-1]


class _HistoryFold(RootFold):
    """Any other formula: carries all samples and evaluates it on them at every sample."""

    def __init__(self, formula: Node, closed: bool) -> None:
        super().__init__(MonitorNode())
        self.formula, self.closed = formula, closed
        self.names = nodes.signals(formula)

    def step(self, now: SampleContext, carry: FoldCarry, i: int) -> FoldCarry:
        newest = [now.sample[name][:, None] for name in self.names]
        newest = [x.reshape((1,) * now.n + x.shape) for x in newest]
        if not carry:
            return tuple(x.copy() for x in newest)
        return tuple(np.concatenate(pair, axis=now.n + 1) for pair in zip(carry, newest, strict=True))

    def result(self, now: SampleContext, carry: FoldCarry) -> Array:
        return self._evaluate(now, carry, now.algebra)

    def value(self, samples: OpenSamples, carry: FoldCarry) -> Array:
        now, unseen, algebra = samples.now, samples.unseen, samples.now.algebra
        if samples.bounded:
            grid = unseen.length or now.t + 2 + nodes.settling(self.formula)
            algebra = IntervalAlgebra(algebra, grid, endless=unseen.length is None)
        return self._evaluate(now, carry, algebra)

    def _evaluate(self, now: SampleContext, carry: FoldCarry, algebra: RobustnessAlgebra) -> Array:
        arrays = [np.moveaxis(x.reshape(x.shape[now.n :]), 1, 0) for x in carry]
        samples = dict(zip(self.names, arrays, strict=True))
        evaluate = Evaluator(samples, now.t + 1, now.rows, algebra, self.closed)
        return np.asarray(evaluate(self.formula)[0])
