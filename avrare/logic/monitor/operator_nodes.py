"""Monitor nodes of comparisons, pointwise operators and temporal operators.

A bounded window is settled by a chain of pairs: two windows of 2^k samples, overlapping or not, make the
wider one. A bounded until or since asks its operands for their newest values. An unbounded past operator
needs only its own last value; an unbounded future one is an obligation with a corner axis of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from avrare.logic.monitor.monitor_node import (
    MonitorNode,
    OpenSamples,
    SampleContext,
    broadcast,
    make_corner,
)
from avrare.logic.semantics.normal_form import is_unbounded_future
from avrare.logic.semantics.trace_evaluator import align, compile_term, connect, get_join, quantify
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.semantics.window_operators import Array, fold_until, get_dual, get_neutral, slide
from avrare.logic.syntax import nodes
from avrare.logic.syntax.nodes import Node

FEW = 16
"""Open values up to which monitors without corners compute them one by one, each from the next."""


def make_nodes(
    formula: Node, children: Sequence[MonitorNode], closed: bool, axes: Mapping[Node, int]
) -> list[MonitorNode]:
    """Make the node of a normalised formula, after the nodes that only it needs.

    Args:
        formula: Formula.
        children: Nodes of its direct sub-formulas.
        closed: True if until and since need their left operand at the witness.
        axes: Unbounded future operators -> their corner axes.
    """
    match formula:
        case nodes.Comparison():
            return [_ComparisonNode(formula)]
        case nodes.Constant(value):
            margin = nodes.Number(math.inf if value else -math.inf)
            return [_ComparisonNode(nodes.Comparison(">", margin, nodes.Number(0.0)))]
        case nodes.Not():
            return [_PointwiseNode(lambda x, algebra, lead: algebra.negate(x[0]), children)]
        case nodes.Connective(op):
            return [_PointwiseNode(lambda x, algebra, lead: connect(op, x[0], x[1], algebra), children)]
        case nodes.Quantifier():
            return [_PointwiseNode(lambda x, algebra, lead: quantify(formula, x[0], lead), children)]
        case nodes.Window(op, lo, hi) | nodes.Until(op, lo, hi):
            join, past = get_join(op), op in nodes.PAST
            if is_unbounded_future(formula):
                return [_ObligationNode(join, children, closed, axes[formula], len(axes))]
            if math.isinf(hi):
                return [_UnboundedPastNode(join, children, closed=closed)]
            if len(children) == 1:
                return _make_window(join, lo, int(hi), children[0], past)
            return [(_SinceNode if past else _UntilNode)(join, children, lo, int(hi), past, closed)]
    raise TypeError(f"not a formula: {formula!r}")


class _ComparisonNode(MonitorNode):
    def __init__(self, formula: nodes.Comparison) -> None:
        super().__init__()
        self.formula = formula
        self._left, self._right = compile_term(formula.left, 1), compile_term(formula.right, 1)

    def value(self, now: SampleContext, i: int) -> Array:
        left, right = self._left(now.sample), self._right(now.sample)
        if type(right) is not float:
            left, right = align(left, right)
        value = now.algebra.compare(self.formula, left, right)
        if not isinstance(value, np.ndarray):
            value = np.full(now.rows, value)
        verdicts: Array = value.reshape((1,) * now.n + value.shape) if now.n else value
        return verdicts

    def open(self, samples: OpenSamples) -> Array:
        newest = samples.now.tables[self.index][-1]
        return samples.fill(
            samples.now.algebra.bound_unseen_samples(self.formula), newest.shape[samples.now.n + 1 :]
        )


class _PointwiseNode(MonitorNode):
    """Operator without time: not, and, or, iff, xor or a quantifier.

    Args:
        apply: Function of the operands' values at the same samples, of their algebra, and of the number of
            axes before those of vehicles.
        children: Operands.
    """

    def __init__(
        self, apply: Callable[[list[Array], RobustnessAlgebra, int], Array], children: Sequence[MonitorNode]
    ) -> None:
        super().__init__(children)
        self._apply = apply

    def value(self, now: SampleContext, i: int) -> Array:
        return self._apply([now.at(child, i) for child in self.children], now.algebra, now.n + 1)

    def open(self, samples: OpenSamples) -> Array:
        operands = [samples.rows(child, samples.start(self)) for child in self.children]
        return self._apply(operands, samples.algebra, samples.lead)


class _TemporalNode(MonitorNode):
    """Operator whose witnesses are joined by ``join``, ``lo`` to ``hi`` samples away."""

    def __init__(
        self,
        join: np.ufunc,
        children: Sequence[MonitorNode],
        lo: int = 0,
        hi: int = 0,
        past: bool = False,
        closed: bool = True,
    ) -> None:
        super().__init__(children, ahead=0 if past else hi, behind=hi if past else 0)
        self.join, self.lo, self.hi, self.past, self.closed = join, lo, hi, past, closed
        self.operands = self.children

    def open(self, samples: OpenSamples) -> Array:
        # Past operators are future ones backwards; all are clipped to the trace.
        count = samples.count(self)
        if self.past:
            rows = [x[::-1] for x in self._operand_rows(samples, self.hi)]
            return self._fold(rows, self.lo, self.hi)[::-1][len(rows[0]) - count :]
        rows = [samples.ahead(x, self.hi) for x in self._operand_rows(samples)]
        return self._fold(rows, self.lo, self.hi)[:count]

    def _operand_rows(self, samples: OpenSamples, behind: int = 0) -> Sequence[Array]:
        start = max(0, samples.start(self) - behind)
        rows = [samples.rows(operand, start) for operand in self.operands]
        return broadcast(*rows) if len(rows) > 1 else rows

    def _fold(self, rows: Sequence[Array], lo: int, hi: float) -> Array:
        if len(rows) == 1:
            return slide(rows[0], lo, hi, self.join)
        return fold_until(rows[0], rows[1], lo, hi, self.closed, self.join)

    def _expand(self, operands: Sequence[Array], later: Array | None) -> Array:
        # Expansion law: a future operator from its value at the next sample, a past one from the previous.
        join, meet = self.join, get_dual(self.join)
        if len(operands) == 1:
            return operands[0] if later is None else np.asarray(join(*align(later, operands[0])))
        left, right = operands
        if later is None:
            left, right = broadcast(left, right)
            return np.asarray(meet(left, right)) if self.closed else right
        if not left.shape == right.shape == later.shape:
            right, later = align(right, later)
            left, right = align(left, right)
            left, later = align(left, later)
        return np.asarray(meet(left, join(right, later)) if self.closed else join(right, meet(left, later)))

    def _fold_operands(self, now: SampleContext, i: int, samples: Iterable[int]) -> Array:
        # The samples are the operands', farthest first.
        left, right = self.children
        value = None
        for k in samples:
            if abs(k - i) >= self.lo:
                value = self._expand((now.at(left, k), now.at(right, k)), value)
            elif value is not None:
                value = np.asarray(get_dual(self.join)(*align(now.at(left, k), value)))
        if value is None:
            like, _ = broadcast(now.at(left, i), now.at(right, i))
            return np.full_like(like, get_neutral(self.join))
        return value


class _PairNode(_TemporalNode):
    """Join of the operand's values at two samples, ``near`` and ``far`` ones ahead (behind if negative)."""

    def __init__(self, join: np.ufunc, child: MonitorNode, near: int, far: int) -> None:
        super().__init__(join, [child], abs(near), abs(far), past=far < 0)
        self.near, self.far = near, far
        newest = self.delay - child.delay + 1
        self._child, self._rows = child, (near - newest, far - newest)
        self._first = self.delay - min(0, near, far) if near != far else math.inf

    def settle(self, now: SampleContext) -> Array:
        # Both values are in the operand's table, as soon as that goes back far enough.
        if now.t < self._first:
            return self.value(now, now.t - self.delay)
        near, far = self._rows
        settled = now.tables[self._child.index]
        verdicts: Array = self.join(settled[near], settled[far])
        return verdicts

    def value(self, now: SampleContext, i: int) -> Array:
        # The values inside the trace; neutral if there are none.
        near, far, child = i + self.near, i + self.far, self._child
        if 0 <= far <= now.t:
            x = now.at(child, far)
            return x if near == far else self.join(now.at(child, near), x)
        if 0 <= near <= now.t:
            return now.at(child, near)
        return np.full_like(now.at(child, i), get_neutral(self.join))


class _WindowNode(_PairNode):
    """Bounded always, eventually, historically or once over ``base``: the last pair of a chain."""

    def __init__(
        self, join: np.ufunc, child: MonitorNode, near: int, far: int, base: MonitorNode, lo: int, hi: int
    ) -> None:
        super().__init__(join, child, near, far)
        self.lo, self.hi, self.operands = lo, hi, (base,)
        self._few = 0 if self.past or lo else min(hi, FEW)
        base.keep = max(base.keep, hi)

    def value(self, now: SampleContext, i: int) -> Array:
        # Where windows are clipped, the next sample's value is extended.
        if i <= now.t - self._few:
            return _PairNode.value(self, now, i)
        x = now.at(self.operands[0], i)
        return x if i == now.t else self.join(x, now.at(self, i + 1))


def _make_window(join: np.ufunc, lo: int, hi: int, base: MonitorNode, past: bool) -> list[MonitorNode]:
    # The width doubles from pair to pair; only the last one has the window's offset.
    sign, width, covered = -1 if past else 1, hi - lo + 1, 1
    chain = [base]
    while 2 * covered < width:
        chain.append(_PairNode(join, chain[-1], 0, sign * covered))
        covered *= 2
    far = lo + width - covered
    return [*chain[1:], _WindowNode(join, chain[-1], sign * lo, sign * far, base, lo, hi)]


class _UnboundedPastNode(_TemporalNode):
    """once, historically, since and trigger over the entire past."""

    keep = 1

    def value(self, now: SampleContext, i: int) -> Array:
        return self._expand([now.at(child, i) for child in self.children], now.before(self, i))

    def open(self, samples: OpenSamples) -> Array:
        rows, settled = self._operand_rows(samples), samples.read_settled(self, 1)
        value = None if settled is None else settled[-1]
        values = [value := self._expand(operands, value) for operands in zip(*rows, strict=True)]
        return np.stack(values) if values else rows[0]


class _SinceNode(_TemporalNode):
    """Bounded since and trigger."""

    def value(self, now: SampleContext, i: int) -> Array:
        return self._fold_operands(now, i, range(max(0, i - self.hi), i + 1))


class _UntilNode(_TemporalNode):
    """Bounded until and release."""

    def value(self, now: SampleContext, i: int) -> Array:
        # Newest first; where windows are clipped, the next value is expanded.
        if not self.lo and i < now.t <= i + self.hi:
            left, right = self.children
            for k in range(now.t if i + self.hi == now.t else i + 1, i, -1):  # keeps the recursion shallow
                later = now.at(self, k)
            return self._expand((now.at(left, i), now.at(right, i)), later)
        return self._fold_operands(now, i, range(min(i + self.hi, now.t), i - 1, -1))


class _ObligationNode(_TemporalNode):
    """Unbounded future operator, the ``axis``-th of ``count``: its value at the next sample is the corner."""

    def __init__(
        self, join: np.ufunc, children: Sequence[MonitorNode], closed: bool, axis: int, count: int
    ) -> None:
        super().__init__(join, children, closed=closed)
        self.obligation = axis
        self.depends |= {axis}
        self._corner = make_corner(axis, count)

    def value(self, now: SampleContext, i: int) -> Array:
        return self._expand([now.at(child, i) for child in self.children], self._corner)

    def open(self, samples: OpenSamples) -> Array:
        return self._fold(self._operand_rows(samples), 0, math.inf)
