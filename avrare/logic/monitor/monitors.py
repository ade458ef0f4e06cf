"""Monitors of a formula's robustness, and of its robust satisfaction interval, one sample at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.monitor.monitor_node import (
    MonitorNode,
    OpenSamples,
    SampleContext,
    UnseenSamples,
    compose,
    lay_out_unseen_samples,
    stack,
)
from avrare.logic.monitor.monitor_plan import MonitorPlan
from avrare.logic.semantics.input_signals import read_sample
from avrare.logic.semantics.trace_evaluator import Evaluator, require_scalar
from avrare.logic.semantics.value_algebra import RobustnessAlgebra, SignedAlgebra, TruthAlgebra, flush
from avrare.logic.semantics.window_operators import Array
from avrare.logic.syntax import nodes
from avrare.protocols import Bools, Floats, Signals, Verdict

_Tables = tuple[tuple[Array, ...], ...]
_PLAIN, _SIGNED, _BOTH = (RobustnessAlgebra(),), (SignedAlgebra(),), (RobustnessAlgebra(), TruthAlgebra())
_ZERO = np.zeros(())
"""NumPy compares faster with an array than with a number."""


class _MonitorCarry(NamedTuple):
    """Arrays (N, ...): values of each node that are still needed, oldest first; carry of each root fold."""

    tables: _Tables
    folds: _Tables


class MonitorState(NamedTuple):
    """State of a robustness monitor: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Carry of the margins, and of the truth if the signs of the margins do not tell it.
        verdict: Verdict on the samples so far; its score is the running maximum of minus the robustness.
        newest: (N,) values of φ at the newest sample in each algebra, for ``always φ``; else empty.
    """

    t: int
    carried: tuple[_MonitorCarry, ...]
    verdict: Verdict
    newest: tuple[Floats, ...]

    @property
    def robustness(self) -> Floats:
        """(N,) robustness of the samples so far."""
        return self.verdict.robustness


class _MonitorEngine:
    """Engine of monitors: settles every node of a plan at each sample.

    One pass gives robustness and truth, except under iff and xor, which need a pass for each.

    Args:
        formula: Formula.
        closed: True if until and since need their left operand at the witness.
        plain: True to keep margins of 0, provided that ``plan.at_zero`` has their truth.

    Attributes:
        is_false: ``is_false(value, 0)`` is where the formula is false.
    """

    def __init__(self, formula: nodes.Node, closed: bool, plain: bool = False) -> None:
        self.closed = closed
        self.plan = MonitorPlan(formula, closed)
        signless = any(map(nodes.is_signless, nodes.walk(formula)))
        at_zero = self.plan.at_zero if plain else None
        self.algebras: tuple[RobustnessAlgebra, ...] = (
            _BOTH if signless else _SIGNED if at_zero is None else _PLAIN
        )
        self.is_false = np.less_equal if at_zero is False else np.less
        settlers = [functools.partial(_settle_corners, x) if x.depends else x.settle for x in self.plan.nodes]
        keeps = [slice(-node.keep, None) if node.keep else slice(0) for node in self.plan.nodes]
        delays = [node.delay for node in self.plan.nodes]
        self._steps = list(zip(range(len(delays)), delays, keeps, settlers, strict=True))
        self._folds = list(enumerate(self.plan.folds))
        self._single = isinstance(self.plan.skeleton, nodes.Slot)

    def start(self) -> tuple[_MonitorCarry, ...]:
        nothing = _MonitorCarry(((),) * len(self.plan.nodes), ((),) * len(self.plan.folds))
        return (nothing,) * len(self.algebras)

    def advance(
        self,
        carried: tuple[_MonitorCarry, ...],
        sample: Mapping[str, Array],
        t: int,
        rows: int,
        unseen: UnseenSamples | None = None,
    ) -> tuple[tuple[_MonitorCarry, ...], list[Array], tuple[Array, ...]]:
        """Settle sample ``t``; return the carry, and the formula's and the body's value in each algebra."""
        n, new, values, newest = len(self.plan.obligations), [], [], []
        for algebra, before in zip(self.algebras, carried, strict=True):
            # 1. Bring the corners to the front.
            if n:
                before = _move_rows(before, 0, n)
            # 2. Settle all nodes, operands first; then all folds.
            now = SampleContext(t, rows, sample, algebra, list(before.tables), n, [None] * n)
            tables = self._settle(now)
            folds = tuple([fold.settle(now, before.folds[k]) for k, fold in self._folds])
            values.append(self._value(now, folds, unseen))
            if self.plan.body:
                newest.append(now.at(self.plan.body, t))
            # 3. Bring the particles back to the front.
            after = _MonitorCarry(tables, folds)
            new.append(_move_rows(after, n, 0) if n else after)
        return tuple(new), values, tuple(newest)

    def _value(self, now: SampleContext, folds: _Tables, unseen: UnseenSamples | None) -> Array:
        # The nominal value (N,), or its bounds (2, N) over all unseen samples.
        # 1. Values of the root folds.
        if unseen is None and self.plan.stepwise:
            algebra = now.algebra
            values = [fold.nominal(now, folds[k]) for k, fold in self._folds]
        else:
            samples = OpenSamples(now, self.plan.obligations, unseen)
            algebra = samples.algebra
            values = [fold.value(samples, folds[k]) for k, fold in self._folds]
        # 2. Connectives and quantifiers above them.
        value = values[0]
        if not self._single:
            slots = [value[None] for value in values]
            value = Evaluator({}, 1, now.rows, algebra, self.closed, slots)(self.plan.skeleton)[0]
        # 3. One value per particle.
        shape = (2, now.rows) if unseen else (now.rows,)
        if value.shape == shape:
            return value
        require_scalar(value.ndim - len(shape))
        return np.broadcast_to(value, shape)

    def _settle(self, now: SampleContext) -> _Tables:
        t, tables, carried = now.t, now.tables, []
        for k, delay, keep, settle in self._steps:
            if t >= delay:
                value = settle(now)  # may replace the table
                tables[k] += (value,)
            carried.append(tables[k][keep])
        return tuple(carried)


@functools.lru_cache(maxsize=256)
def _get_engine(formula: nodes.Node, closed: bool, plain: bool = False) -> _MonitorEngine:
    return _MonitorEngine(formula, closed, plain)


def _settle_corners(node: MonitorNode, now: SampleContext) -> Array:
    i, value = now.t - node.delay, None
    if node.obligation is not None:
        value = now.values[node.obligation] = node.value(now, i)
    before = now.tables[node.index]
    if before:
        now.tables[node.index] = tuple(compose(stack(before), now.values, 1))
    return node.value(now, i) if value is None else value


def _update_score(before: Floats, robustness: Floats, trend: np.ufunc | None, t: int) -> Floats:
    if trend is np.minimum:
        return -robustness
    if trend is np.maximum and t:
        return before
    return np.fmax(before, -robustness)


def _move_rows(carry: _MonitorCarry, axis: int, to: int) -> _MonitorCarry:
    # (N, corners, ...) to (corners, N, ...) or back.
    return _MonitorCarry(
        *(tuple([tuple([_move(x, axis, to) for x in table]) for table in tables]) for tables in carry)
    )


def _move(x: Array, axis: int, to: int) -> Array:
    axes = list(range(x.ndim))  # faster than np.moveaxis
    axes.insert(to, axes.pop(axis))
    return x.transpose(axes)


class _Monitor:
    def __init__(self, node: nodes.Node, closed: bool, plain: bool = False) -> None:
        self._node, self._closed = node, closed
        self._engine = _get_engine(node, closed, plain)
        self._names = nodes.signals(node)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._node, self._closed)


class RobustnessMonitor(_Monitor):
    """Monitor of a formula's robustness at sample 0 (an ``avrare.protocols.Specification``).

    Every step costs the same, except for the few formulas that ``plan`` names, whose history is carried and
    evaluated. NaN makes a row's robustness NaN for good if the formula depends on it; that row is neither
    violated nor does its score change.

    Args:
        node: Formula.
        closed: True if until and since need their left operand at the witness.
    """

    def __init__(self, node: nodes.Node, closed: bool) -> None:
        super().__init__(node, closed, plain=True)

    def start(self, n: int) -> MonitorState:
        """Return the state of ``n`` particles before sample 0."""
        newest = (np.full(n, math.inf),) * len(self._engine.algebras) if self._engine.plan.body else ()
        verdict = Verdict(np.full(n, math.inf), np.zeros(n, dtype=np.bool_), np.full(n, -math.inf))
        return MonitorState(0, self._engine.start(), verdict, newest)

    def margin(self, state: MonitorState) -> Floats | None:
        """Return the robustness (N,) of φ at the newest sample, for ``always φ`` with φ not looking ahead.

        It is infinite before sample 0, and None for other formulas. Unlike the running minimum it
        distinguishes particles that have been equally near to failure.
        """
        return flush(state.newest[0]) if state.newest else None

    def holds(self, state: MonitorState) -> Bools:
        """Return where φ is true (N,) at the newest sample, for ``always φ`` as in ``margin``."""
        return np.asarray(~self._engine.is_false(state.newest[-1], _ZERO))

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Return state and verdict after one more sample.

        Args:
            state: State before the sample; not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape.
        """
        t, before, engine = state.t, state.verdict, self._engine
        plan, rows = engine.plan, len(before.score)
        sample = read_sample(signals, self._names, rows)
        if t > plan.horizon:
            return MonitorState(t + 1, (), before, state.newest), before
        with nullcontext() if plan.quiet else np.errstate(all="ignore"):
            carried, values, newest = engine.advance(state.carried, sample, t, rows)
            robustness, violated = flush(values[0]), engine.is_false(values[-1], _ZERO)
            if len(values) > 1:
                violated &= ~np.isnan(robustness)
            trend = plan.trend if robustness is values[0] else None  # only then there is no NaN
            score = _update_score(before.score, robustness, trend, t)
        verdict = Verdict(robustness, violated, score)
        return MonitorState(t + 1, carried, verdict, newest), verdict


@dataclass(frozen=True)
class IntervalVerdict:
    """Possible outcomes of the formula at sample 0 over all continuations.

    Attributes:
        lower: (N,) least robustness; never falls.
        upper: (N,) greatest robustness; never rises.
        decided: (N,) True where the truth is final.
        violated: (N,) True where it is final and false.
    """

    lower: Floats
    upper: Floats
    decided: Bools
    violated: Bools


@dataclass(frozen=True)
class IntervalState:
    """State of an interval monitor: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Carry, as in ``MonitorState``.
        verdict: Verdict after the last sample; before the first everything is possible.
    """

    t: int
    carried: tuple[_MonitorCarry, ...]
    verdict: IntervalVerdict


class IntervalMonitor(_Monitor):
    """Monitor of bounds of a formula's robustness at sample 0 over all continuations.

    The bounds come from interval arithmetic: they hold for every continuation, and are exact unless a sample
    is used more than once, as it is under ``rise`` and ``fall``. Every step costs the same, as with
    ``RobustnessMonitor``. A row whose value is NaN is never decided.

    Args:
        node: Formula.
        closed: True if until and since need their left operand at the witness.
        length: Samples of the complete trace, at the last of which the bounds meet; None: endless.

    Raises:
        FormulaError: ``length`` is below 1.
    """

    def __init__(self, node: nodes.Node, closed: bool, length: int | None = None) -> None:
        if length is not None and length < 1:
            raise FormulaError(f"length must be at least 1, not {length}", "leave it out where it is unknown")
        super().__init__(node, closed)
        self.length = length

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._node, self._closed, self.length)

    def start(self, n: int) -> IntervalState:
        """Return the state of ``n`` particles before sample 0."""
        undecided = np.zeros(n, dtype=np.bool_)
        nothing = IntervalVerdict(np.full(n, -math.inf), np.full(n, math.inf), undecided, undecided)
        return IntervalState(0, self._engine.start(), nothing)

    def update(self, state: IntervalState, signals: Signals) -> tuple[IntervalState, IntervalVerdict]:
        """Return state and verdict after one more sample.

        Args:
            state: State before the sample; not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape, or the trace is longer than its length.
        """
        if self.length is not None and state.t >= self.length:
            raise FormulaError(f"length is {self.length} but there are more samples")
        t, engine, rows = state.t, self._engine, len(state.verdict.lower)
        sample = read_sample(signals, self._names, rows)
        if t > engine.plan.horizon:
            return IntervalState(t + 1, (), state.verdict), state.verdict
        unseen = lay_out_unseen_samples(t + 1, engine.plan.settling, engine.plan.reach, self.length)
        with np.errstate(all="ignore"):
            carried, values, _ = engine.advance(state.carried, sample, t, rows, unseen)
        (lower, upper), truth = flush(values[0]), values[-1]
        violated = truth[1] < 0.0
        decided = violated | (truth[0] > 0.0)
        if len(values) > 1:
            present = ~np.isnan(lower)
            violated, decided = violated & present, decided & present
        verdict = IntervalVerdict(lower, upper, decided, violated)
        return IntervalState(t + 1, carried, verdict), verdict
