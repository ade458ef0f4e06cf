"""Following a formula one sample at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.algebra import Robustness, Signed, Truth, flush
from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import compose, stack
from avrare.logic.plan import Plan, make_plan
from avrare.logic.region import Region, Tail, make_tail
from avrare.logic.robustness import Evaluator, require_scalar
from avrare.logic.samples import read_sample
from avrare.protocols import Floats, Signals, Verdict

if TYPE_CHECKING:
    from avrare.logic.api import Formula

Array = NDArray[Any]
Tables = tuple[tuple[Array, ...], ...]
_PLAIN, _SIGNED, _APART = (Robustness(),), (Signed(),), (Robustness(), Truth())
_ZERO = np.zeros(())
"""NumPy compares with an array sooner than with a number."""


class Carried(NamedTuple):
    """What is carried from sample to sample: arrays with leading axis N.

    Attributes:
        tables: Per cell, its newest settled values (N, ...) that are still needed, oldest first.
        leaves: Per leaf, what it folded so far.
    """

    tables: Tables
    leaves: Tables


class MonitorState(NamedTuple):
    """A monitor's state: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Of the margins; a second one of the truth where the margins' signs do not tell it.
        verdict: On the samples so far; its score is the running maximum of minus the robustness.
        newest: (N,) for ``always φ``: the margin of φ at the newest sample; else None.
    """

    t: int
    carried: tuple[Carried, ...]
    verdict: Verdict
    newest: Floats | None

    @property
    def robustness(self) -> Floats:
        """(N,) of the samples so far."""
        return self.verdict.robustness


class Follower:
    """The engine of monitors: settles every cell of a formula's plan at each sample.

    One pass gives robustness and truth, except under iff and xor: those need a pass for each.

    Args:
        node: The formula.
        closed: The reading of until and since.
        plain: Take margins as they are, 0 included, where ``plan.at_zero`` tells the truth of that.

    Attributes:
        fails: ``fails(value, 0)`` is where the formula is false.
    """

    def __init__(self, node: f.Node, closed: bool, plain: bool = False) -> None:
        self.closed = closed
        self.plan: Plan = make_plan(node, closed)
        apart = any(isinstance(x, f.Connective) and x.op in ("iff", "xor") for x in f.walk(node))
        at_zero = self.plan.at_zero if plain else None
        self.algebras: tuple[Robustness, ...] = _APART if apart else _SIGNED if at_zero is None else _PLAIN
        self.fails = np.less_equal if at_zero is False else np.less
        cells = self.plan.cells
        settles = [functools.partial(_compose, cell) if cell.depends else cell.settle for cell in cells]
        keeps = [slice(-cell.keep, None) if cell.keep else slice(0) for cell in cells]
        delays = [cell.delay for cell in cells]
        self._steps = list(zip(range(len(cells)), delays, keeps, settles, strict=True))
        self._leaves = list(enumerate(self.plan.leaves))
        self._single = isinstance(self.plan.skeleton, f.Slot)

    def start(self) -> tuple[Carried, ...]:
        """Before sample 0."""
        nothing = Carried(((),) * len(self.plan.cells), ((),) * len(self.plan.leaves))
        return (nothing,) * len(self.algebras)

    def advance(
        self, carried: tuple[Carried, ...], sample: Mapping[str, Array], t: int, rows: int
    ) -> tuple[tuple[Carried, ...], list[tuple[Moment, Tables]]]:
        """Carried after sample ``t``, and per algebra what the cells and the leaves know."""
        n, new, seen = len(self.plan.obligations), [], []
        for k, algebra in enumerate(self.algebras):
            before = carried[k]
            if n:
                before = Carried(*(_corners_first(x, n) for x in before))
            now = Moment(t, rows, sample, algebra, before.tables, n)
            after = Carried(self._settle(now), self._fold(now, before.leaves))
            seen.append((now, after.leaves))
            new.append(Carried(*(_rows_first(x, n) for x in after)) if n else after)
        return tuple(new), seen

    def value(self, now: Moment, leaves: Tables, tail: Tail | None = None) -> Array:
        """The formula's value as things stand: (N,), or its bounds (2, N)."""
        if tail is None and self.plan.stepwise:
            algebra = now.algebra
            values = [leaf.nominal(now, leaves[k]) for k, leaf in self._leaves]
        else:
            region = Region(now, self.plan.obligations, tail)
            algebra = region.algebra
            values = [leaf.value(region, leaves[k]) for k, leaf in self._leaves]
        value = values[0]
        if not self._single:
            slots = [value[None] for value in values]
            value = Evaluator({}, 1, now.rows, algebra, self.closed, slots)(self.plan.skeleton)[0]
        shape = (2, now.rows) if tail else (now.rows,)
        if value.shape == shape:
            return value
        require_scalar(value.ndim - len(shape))
        return np.broadcast_to(value, shape)

    def tail(self, seen: int, length: int | None) -> Tail:
        """The samples to come."""
        return make_tail(seen, self.plan.settling, self.plan.reach, length)

    def _settle(self, now: Moment) -> Tables:
        """Settle all cells; the tables to carry on."""
        t, tables, kept = now.t, now.tables, []
        for k, delay, keep, settle in self._steps:
            if t >= delay:
                value = settle(now)  # which may change the table
                tables[k] += (value,)
            kept.append(tables[k][keep])
        return tuple(kept)

    def _fold(self, now: Moment, before: Tables) -> Tables:
        """Settle all leaves; what they carry on."""
        return tuple([leaf.settle(now, before[k]) for k, leaf in self._leaves])


@functools.lru_cache(maxsize=256)
def follower(node: f.Node, closed: bool, plain: bool = False) -> Follower:
    """The engine of a formula, kept for the next monitor of the same formula."""
    return Follower(node, closed, plain)


def _compose(cell: Cell, now: Moment) -> Array:
    """The value of a cell that depends on obligations; its table is brought to the new corners."""
    i, value = now.t - cell.delay, None
    if cell.obligation is not None:
        value = now.values[cell.obligation] = cell.value(now, i)
    before = now.tables[cell.index]
    if before:
        now.tables[cell.index] = tuple(compose(stack(before), now.values, 1))
    return cell.value(now, i) if value is None else value


def _nearest(before: Floats, robustness: Floats, trend: np.ufunc | None, t: int) -> Floats:
    """The running maximum of minus the robustness: the newest if that only falls, the first if it rises."""
    if trend is np.minimum:
        return -robustness
    if trend is np.maximum and t:
        return before
    return np.fmax(before, -robustness)


def _corners_first(tables: Tables, n: int) -> Tables:
    """(N, corners, ...) as (corners, N, ...)."""
    return tuple([tuple([_move(x, 0, n) for x in table]) for table in tables])


def _rows_first(tables: Tables, n: int) -> Tables:
    """(corners, N, ...) as (N, corners, ...)."""
    return tuple([tuple([_move(x, n, 0) for x in table]) for table in tables])


def _move(x: Array, axis: int, to: int) -> Array:
    """``np.moveaxis``, only faster."""
    axes = list(range(x.ndim))
    axes.insert(to, axes.pop(axis))
    return x.transpose(axes)


class FormulaMonitor:
    """Follows a formula at sample 0 (an ``avrare.protocols.Specification``).

    A step costs the same at every sample; ``avrare.logic.plan`` names the few formulas whose history is kept
    and evaluated. NaN makes a row's robustness NaN for good where the formula depends on it; such a row is
    neither violated nor does its score change.

    Args:
        formula: From ``avrare.stl``.
    """

    def __init__(self, formula: Formula) -> None:
        self.formula = formula
        self._follower = follower(formula.node, formula.closed, plain=True)
        self._names = formula.signals

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.formula,)

    def start(self, n: int) -> MonitorState:
        """Monitor state of ``n`` particles before sample 0."""
        newest = np.full(n, math.inf) if self._follower.plan.body else None
        verdict = Verdict(np.full(n, math.inf), np.zeros(n, dtype=np.bool_), np.full(n, -math.inf))
        return MonitorState(0, self._follower.start(), verdict, newest)

    def margin(self, state: MonitorState) -> Floats | None:
        """For ``always φ``, φ looking only back: the robustness (N,) of φ at the newest sample; else None.

        It is infinite before sample 0. Unlike the running minimum it tells apart particles that have been
        equally near to failure.
        """
        return None if state.newest is None else flush(state.newest)

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Monitor state and verdict after one more sample.

        Args:
            state: Not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape.
        """
        sample = read_sample(signals, self._names, len(state.verdict.score))
        if self._follower.plan.quiet:
            new = self.follow(state, sample)
        else:
            with np.errstate(all="ignore"):
                new = self.follow(state, sample)
        return new, new.verdict

    def follow(self, state: MonitorState, sample: Mapping[str, Array]) -> MonitorState:
        """The state after one more sample, already read."""
        t, before, engine = state.t, state.verdict, self._follower
        plan = engine.plan
        if t > plan.horizon:
            return MonitorState(t + 1, (), before, state.newest)
        carried, seen = engine.advance(state.carried, sample, t, len(before.score))
        values = [engine.value(now, leaves) for now, leaves in seen]
        robustness, violated = flush(values[0]), engine.fails(values[-1], _ZERO)
        if len(values) > 1:
            violated &= ~np.isnan(robustness)
        trend = plan.trend if robustness is values[0] else None  # else there might be NaN
        score = _nearest(before.score, robustness, trend, t)
        newest = seen[0][0].at(plan.body, t) if plan.body else None
        return MonitorState(t + 1, carried, Verdict(robustness, violated, score), newest)
